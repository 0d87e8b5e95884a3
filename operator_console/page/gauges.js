// Values with unit and age, budgets as bars, phases, alarms and health.

import { LEVELS, SIGNS, age, element, machineTime, number, setText } from "./format.js";

// key of the reading, label, unit, digits
const GAUGES = [
  ["depth", "Depth", "m", 2],
  ["tension", "Tension", "N", 1],
  ["swing_major", "Swing", "deg", 2],
  ["heading", "Heading", "deg", 1],
  ["depth_goal", "Depth goal", "m", 2],
  ["payout_rate", "Payout rate", "m/s", 3],
  ["camera_rate", "Camera rate", "deg/s", 2],
  ["stops_left", "Stops left", "", 0],
];
const BUDGETS = [
  ["wheels_budget", "Wheels"],
  ["flywheel_budget", "Flywheel"],
  ["travel_budget", "Screw travel"],
];
const PHASES = [
  ["mission", "Mission"],
  ["descent", "Descent"],
  ["winch", "Winch"],
  ["drive", "Drive"],
  ["jump", "Jump"],
  ["plant", "Rover"],
];
const OPTIONAL = new Set(["mission", "drive", "jump"]); // shown once their node has reported

export class Gauges {
  constructor() {
    this.gauges = new Map();
    const root = document.getElementById("gauges");
    for (const [name, label, unit] of GAUGES) {
      const value = element("b", { class: "value" });
      const old = element("small", { class: "age" });
      const box = element("div", { class: "gauge", "data-value": name }, element("span", { class: "label" }, label),
        element("span", { class: "reading" }, value, element("span", { class: "unit" }, unit)), old);
      root.append(box);
      this.gauges.set(name, { box, value, old });
    }
    this.budgets = new Map();
    const bars = document.getElementById("budgets");
    for (const [name, label] of BUDGETS) {
      const fill = element("div", { class: "fill" });
      const text = element("b", { class: "value" });
      const old = element("small", { class: "age" });
      const box = element("div", { class: "budget", "data-value": name }, element("span", { class: "label" }, `${label} budget`),
        element("div", { class: "bar", "aria-hidden": "true" }, fill, element("i", { class: "zero" })), text, old);
      bars.append(box);
      this.budgets.set(name, { box, fill, text, old });
    }
    this.phases = new Map();
    const doing = document.getElementById("doing");
    for (const [name, label] of PHASES) {
      const value = element("dd", { "data-phase": name });
      doing.append(element("div", {}, element("dt", {}, label), value));
      this.phases.set(name, value);
    }
    this.time = element("dd", { id: "machine-time" });
    doing.append(element("div", {}, element("dt", {}, "Machine time"), this.time));
  }

  // since: age of the frame [s], which adds to the age of every value.
  show(frame, since, isOld) {
    for (const [name, , unit, digits] of GAUGES) {
      const parts = this.gauges.get(name);
      const [value, old, isStale] = frame.values[name] ?? [null, null, true];
      setText(parts.value, value === null ? "–" : number(value, digits));
      mark(parts.box, parts.old, value, old, isStale || isOld, since);
      parts.box.setAttribute("aria-label", `${name.replaceAll("_", " ")} ${value === null ? "unknown" : `${number(value, digits)} ${unit}`}`);
    }
    for (const [name] of BUDGETS) {
      const parts = this.budgets.get(name);
      const [value, old, isStale] = frame.values[name] ?? [null, null, true];
      const part = value === null ? 0 : Math.max(-1, Math.min(1, value / 100));
      parts.fill.style.left = `${50 + Math.min(0, part) * 50}%`;
      parts.fill.style.width = `${Math.abs(part) * 50}%`;
      const level = value === null ? "unknown" : Math.abs(value) >= 100 ? "error" : Math.abs(value) >= 80 ? "warn" : "ok";
      parts.box.dataset.level = level;
      setText(parts.text, value === null ? "–" : `${level === "ok" ? "" : `${SIGNS[level]} `}${number(value, 0)} %`);
      mark(parts.box, parts.old, value, old, isStale || isOld, since);
    }
    for (const [name] of PHASES) {
      const node = this.phases.get(name);
      const [phase, old, isStale, isBad] = frame.phases[name] ?? ["", null, true, false];
      const stale = phase && (isStale || isOld);
      node.classList.toggle("bad", Boolean(isBad));
      setText(node, phase ? phase.replaceAll("_", " ") + (stale && old !== null ? ` (${age(old + since)})` : "") : "–");
      node.classList.toggle("stale", Boolean(stale));
      node.parentElement.hidden = !phase && OPTIONAL.has(name);
    }
    setText(this.time, machineTime(frame.time));
    this.showHealth(frame, isOld);
  }

  showHealth(frame, isOld) {
    const box = document.getElementById("health");
    const health = isOld ? { level: "stale", title: "stale", text: "the values are not current" } : frame.health;
    box.dataset.level = health.level;
    setText(box.querySelector(".sign"), SIGNS[health.level] ?? "?");
    setText(document.getElementById("health-title"), health.title);
    setText(document.getElementById("health-text"), health.text);
    const rows = frame.parts.map(({ name, level, text, age: old }) => {
      const shown = isOld ? "stale" : LEVELS.includes(level) ? level : "stale";
      return { key: name, level: shown, text, old: old !== null && old > 3 ? age(old) : "" };
    });
    const list = document.getElementById("nodes");
    const written = JSON.stringify(rows);
    if (this.written === written) return;
    this.written = written;
    list.replaceChildren(...rows.map((row) => element("li", { "data-level": row.level },
      element("span", { class: "sign", "aria-label": row.level }, SIGNS[row.level]),
      element("b", {}, row.key), element("span", {}, row.text), element("small", {}, row.old))));
    if (!rows.length) list.append(element("li", { "data-level": "stale" }, "no node has reported its health"));
  }
}

function mark(box, node, value, old, isStale, since) {
  box.classList.toggle("stale", isStale && value !== null);
  box.classList.toggle("unknown", value === null);
  setText(node, value === null ? (old === null ? "no data" : "unknown") : isStale ? age(old + since) : "");
}
