// What happened, newest first: events, refusals, and what operators asked for.

import { SIGNS, element, moment } from "./format.js";

const MOST = 300;

export class Journal {
  constructor(root) {
    this.root = root;
    this.entries = [];
  }

  // entry: {time, level, source, title, text}
  add(entry) {
    this.entries.push(entry);
    if (this.entries.length > MOST) this.entries.shift();
    this.root.prepend(row(entry));
    while (this.root.children.length > MOST) this.root.lastChild.remove();
  }

  fill(entries) {
    this.entries = entries.slice(-MOST);
    this.root.replaceChildren(...[...this.entries].reverse().map(row));
  }

  // Entries up to a time are shown, later ones are not yet.
  showUpTo(time) {
    [...this.root.children].forEach((child, index) => {
      child.hidden = this.entries[this.entries.length - 1 - index].time > time;
    });
  }
}

function row({ time, level, source, title, text }) {
  return element("li", { "data-level": level },
    element("time", {}, moment(time)), element("span", { class: "sign", "aria-label": level }, SIGNS[level] ?? "·"),
    element("div", {}, element("b", {}, title.replaceAll("_", " ")), element("span", {}, ` ${text}`), element("small", {}, ` ${source}`)));
}
