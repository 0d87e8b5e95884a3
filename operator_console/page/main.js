// Connects the link and the replay with views, values, plots and commands.

import { Commands } from "./commands.js";
import { age, number, setText } from "./format.js";
import { Gauges } from "./gauges.js";
import { Journal } from "./journal.js";
import { Link } from "./link.js";
import { Plots } from "./plots.js";
import { Records } from "./records.js";
import { Replay } from "./replay.js";
import { View } from "./views.js";

const PLOT_PERIOD = 250; // [ms]
const SOURCES = { simulation: "simulated position", payout: "straight line of the paid-out length" };

const MODES = { live: "LIVE", stale: "STALE", paused: "PAUSED", absent: "NO PLANT", lost: "LOST", silent: "SILENT", replay: "REPLAY" };

const state = { frame: null, at: 0, machine: null, place: null, mayCommand: false, link: "lost", frameAge: null };
applyTheme(stored("theme") ?? "auto");

const side = new View(document.getElementById("side"), [0, 2]);
const top = new View(document.getElementById("top"), [0, 1]);
const gauges = new Gauges();
const journal = new Journal(document.getElementById("journal"));
const records = new Records(document.getElementById("records"));
const plots = new Plots(document.getElementById("plots"), (time) => replay.isOpen && replay.goTo(time));
const replay = new Replay({
  onOpen: (opened) => {
    plots.fill(opened.bag.frames);
    journal.fill(opened.bag.journal);
    side.trail = []; top.trail = [];
    for (const view of [side, top]) { view.place = opened.bag.place; view.machine = opened.bag.machine; }
    showMode();
  },
  onFrame: (frame, opened) => {
    show(frame, 0, false);
    journal.showUpTo(frame.time);
    plots.draw([opened.first, opened.last], frame.time);
  },
  onClose: () => {
    for (const view of [side, top]) { view.trail = []; view.place = state.place; view.machine = state.machine; }
    plots.range = null;
    plots.fill(history.frames);
    journal.fill(history.journal);
    showMode();
    refresh();
    plots.draw(null);
  },
  onFail: (text) => commands.show("✕", "replay", text, "error"),
});
const history = { frames: [], journal: [] };
const commands = new Commands({
  send: (name, values) => link.command(name, values),
  renew: (name, press) => link.renew(name, press),
  now: () => `Now: depth ${reading("depth", 2)} m, tension ${reading("tension", 1)} N, descent ${phase("descent")}, winch ${phase("winch")}.`,
});
const link = new Link({ onContent: receive, onState: showLink });
showLink("lost", null);

function receive(content) {
  if (content.kind === "welcome") {
    state.mayCommand = content.may_command;
    document.getElementById("leave").hidden = !content.by_token;
    showLink(link.state, link.frameAge());
  } else if (content.kind === "commands") {
    commands.fill(content.commands);
    showLink(link.state, link.frameAge());
  } else if (content.kind === "machine" || content.kind === "place") {
    state[content.kind] = content[content.kind];
    if (!replay.isOpen) for (const view of [side, top]) view.set(content.kind, state[content.kind]);
  } else if (content.kind === "history") {
    history.frames = content.frames;
    history.journal = content.journal;
    if (!replay.isOpen) { plots.fill(history.frames); journal.fill(history.journal); plots.draw(null); }
  } else if (content.kind === "journal") {
    history.journal.push(...content.entries);
    history.journal.splice(0, history.journal.length - 300);
    if (!replay.isOpen) content.entries.forEach((entry) => journal.add(entry));
  } else if (content.kind === "frame") {
    const isNewMode = state.frame?.mode !== content.mode;
    state.frame = content;
    state.at = performance.now();
    keepHistory(content);
    commands.setObstacles(content.obstacles);
    if (isNewMode) showMode();
    if (!replay.isOpen) { plots.add(content); refresh(); }
  }
}

function keepHistory(frame) {
  const last = history.frames.at(-1);
  if (last && frame.time < last.time) history.frames.length = 0;
  if (!last || frame.time - last.time >= 0.5 || frame.time < last.time) history.frames.push({ time: frame.time, values: frame.values });
  if (history.frames.length > 2000) history.frames.splice(0, 200);
}

function refresh() {
  if (replay.isOpen || !state.frame) return;
  show(state.frame, (performance.now() - state.at) / 1000, state.link !== "live");
}

function show(frame, since, isOld) {
  side.show(frame, isOld);
  top.show(frame, isOld);
  gauges.show(frame, since, isOld);
  records.show(frame.commands, isOld);
  const geometry = frame.geometry;
  const text = geometry ? `${SOURCES[geometry.source]}${geometry.stale || isOld ? `, ${age(geometry.age + since)}` : ""}` : "";
  setText(document.getElementById("side-source"), text);
  setText(document.getElementById("top-source"), text);
}

function showLink(name, frameAge) {
  state.link = name;
  state.frameAge = frameAge;
  document.body.dataset.link = name;
  const shown = frameAge === null ? "No data was received yet." : `The values are ${age(frameAge)}.`;
  setText(document.getElementById("lost-title"), name === "silent" ? "SERVER SILENT" : "NO CONNECTION");
  setText(document.getElementById("lost-text"), `${name === "silent" ? "The console server sends no data." : "The console server cannot be reached."} ${shown} ${name === "silent" ? "Only HOLD and ABORT are sent; whether they arrive is unknown." : "Commands are disabled."}`);
  showMode();
  refresh();
}

function showMode() {
  const mode = replay.isOpen ? "replay" : state.link === "live" ? state.frame?.mode ?? "absent" : state.link;
  const box = document.getElementById("mode");
  box.dataset.mode = mode;
  document.body.dataset.mode = replay.isOpen ? "replay" : "live";
  setText(document.getElementById("plots-title"), replay.isOpen ? "Whole bag (click to select a time)" : "Recent values");
  setText(document.getElementById("mode-title"), MODES[mode]);
  const remarks = replay.isOpen ? [replay.bag.name, ...replay.bag.remarks].join("; ") : state.mayCommand ? "" : "view only";
  setText(document.getElementById("mode-text"), remarks);
  document.getElementById("mode-text").title = remarks;
  const why = state.link !== "live" ? MODES[state.link] : !state.mayCommand ? "view only" : replay.isOpen ? "replay: return to live to send commands" : "";
  // HOLD and ABORT stay available during a replay, and as long as they may reach the server.
  commands.enable(!why, why, state.link !== "lost" && state.mayCommand);
}

function reading(name, digits) {
  const found = state.frame?.values[name];
  return found ? number(found[0], digits) : "–";
}

function phase(name) {
  return state.frame?.phases[name]?.[0]?.replaceAll("_", " ") || "no data";
}

setInterval(() => { if (!replay.isOpen && state.link === "live") plots.draw(null); }, PLOT_PERIOD);

for (const button of document.querySelectorAll("[data-view]")) {
  button.addEventListener("click", () => {
    const view = button.dataset.view === "side" ? side : top;
    view.set("extent", button.dataset.extent);
    select(button, `[data-view="${button.dataset.view}"]`);
  });
}
for (const button of document.querySelectorAll("[data-minutes]")) {
  button.addEventListener("click", () => {
    plots.window = 60 * Number(button.dataset.minutes);
    select(button, "[data-minutes]");
    if (!replay.isOpen) plots.draw(null);
  });
}
function select(button, all) {
  for (const each of document.querySelectorAll(all)) each.setAttribute("aria-pressed", String(each === button));
}

document.getElementById("theme").addEventListener("click", () => {
  const isDark = getComputedStyle(document.documentElement).getPropertyValue("--is-dark").trim() === "1";
  applyTheme(isDark ? "light" : "dark");
  plots.build();
  side.draw();
  top.draw();
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { plots.build(); side.draw(); top.draw(); });

function applyTheme(name) {
  document.documentElement.dataset.theme = name;
  try { localStorage.setItem("theme", name); } catch { /* not stored: the theme is chosen again next time */ }
}

function stored(name) {
  try { return localStorage.getItem(name); } catch { return null; }
}
