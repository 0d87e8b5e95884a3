// The journal, newest entry first: events, refusals and operators' commands.

import { SIGNS, element, machineTime } from "./format.js";

const LENGTH = 300;

export class Journal {
  constructor(root) {
    this.root = root;
    this.entries = [];
  }

  // entry: {time, level, source, title, text}
  add(entry) {
    this.entries.push(entry);
    if (this.entries.length > LENGTH) this.entries.shift();
    this.root.prepend(row(entry));
    while (this.root.children.length > LENGTH) this.root.lastChild.remove();
  }

  fill(entries) {
    this.entries = entries.slice(-LENGTH);
    this.root.replaceChildren(...[...this.entries].reverse().map(row));
  }

  // Hide the entries after a time.
  showUpTo(time) {
    [...this.root.children].forEach((child, index) => {
      child.hidden = this.entries[this.entries.length - 1 - index].time > time;
    });
  }
}

function row({ time, level, source, title, text }) {
  return element("li", { "data-level": level },
    element("time", {}, machineTime(time)), element("span", { class: "sign", "aria-label": level }, SIGNS[level] ?? "·"),
    element("div", {}, element("b", {}, title.replaceAll("_", " ")), element("span", {}, ` ${text}`), element("small", {}, ` ${source}`)));
}
