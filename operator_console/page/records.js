// The last commands of all senders and what became of them, the last changed one first. The identifier
// of a command is in its tooltip.

import { SIGNS, element, machineTime } from "./format.js";

export class Records {
  constructor(root) {
    this.root = root;
    this.written = "";
  }

  // commands: [{time, title, sender, state, progress, text, level, over}]; isOld: whether no new frames arrive.
  show(commands, isOld) {
    const written = JSON.stringify([commands, isOld]);
    if (this.written === written) return;
    this.written = written;
    this.root.replaceChildren(...[...commands].reverse().map((each) => row(each, isOld)));
    if (!commands.length) this.root.append(element("li", {}, "no command was taken"));
  }
}

function row({ time, title, sender, state, progress, text, level, over }, isOld) {
  const shown = isOld && !over ? "stale" : level;
  const name = sender.includes("#") ? sender.slice(0, sender.lastIndexOf("#")) : "";
  const share = progress === null || over ? "" : ` ${Math.round(100 * progress)} %`;
  const made = element("li", { "data-level": shown, "data-state": state },
    element("time", {}, machineTime(time)),
    element("span", { class: "sign", "aria-label": shown }, over || isOld ? SIGNS[shown] : "▸"),
    element("div", { title: sender }, element("b", {}, `${state}${share}`), element("span", {}, ` ${title.replaceAll("_", " ")}`),
      element("small", {}, ` ${[text, name].filter(Boolean).join("; ")}`)));
  return made;
}
