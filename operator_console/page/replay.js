// Replay of a bag: its frames in the same views, its events as marks on the timeline.

import { clock, element, setText } from "./format.js";

const MAX_MARKS = 100;
const RANKS = ["ok", "warn", "error"];

export class Replay {
  // onFrame(frame, replay) shows a frame; onOpen(replay) and onClose() change the mode of the page.
  constructor({ onFrame, onOpen, onClose, onFail }) {
    Object.assign(this, { onFrame, onOpen, onClose, onFail });
    this.bag = null;
    this.index = 0;
    this.isPlaying = false;
    this.parts = Object.fromEntries(["bags", "play", "speed", "scrub", "marks", "live", "replay-time"].map((id) => [id, document.getElementById(id)]));
    this.parts.bags.addEventListener("change", () => (this.parts.bags.value ? this.open(this.parts.bags.value) : this.close()));
    this.parts.bags.addEventListener("focus", () => this.list());
    this.parts.play.addEventListener("click", () => this.play(!this.isPlaying));
    this.parts.scrub.addEventListener("input", () => { this.play(false); this.go(Number(this.parts.scrub.value)); });
    this.parts.live.addEventListener("click", () => this.close());
    this.list();
  }

  get isOpen() { return this.bag !== null; }

  async list() {
    try {
      const { bags } = await (await fetch("/bags")).json();
      const names = bags.map(({ name }) => name);
      if (names.join("\n") === this.names) return;
      this.names = names.join("\n");
      const chosen = this.parts.bags.value;
      const first = element("option", { value: "" }, names.length ? "live" : "live (no bags)");
      this.parts.bags.replaceChildren(first, ...bags.map(({ name, size }) =>
        element("option", { value: name }, `${name} (${(size / 1e6).toFixed(1)} MB)`)));
      this.parts.bags.value = chosen;
    } catch { /* the page shows the lost connection */ }
  }

  async open(name) {
    setText(this.parts["replay-time"], `reading ${name} …`);
    this.parts.bags.disabled = true;
    try {
      const answer = await fetch(`/bags/${encodeURIComponent(name)}`);
      const content = await answer.json();
      if (!answer.ok) throw new Error(content.error);
      this.load(content);
    } catch (error) {
      this.parts.bags.value = this.bag?.name ?? "";
      this.onFail(`${name} cannot be replayed: ${error.message}`);
      this.showTime();
    } finally {
      this.parts.bags.disabled = false;
    }
  }

  load(bag) {
    // Unchanged parts, health and commands are omitted in the bag.
    bag.frames.reduce((before, frame) => {
      frame.parts ??= before?.parts ?? [];
      frame.commands ??= before?.commands ?? [];
      frame.health ??= before?.health ?? { level: "unknown", title: "no data", text: "" };
      return frame;
    }, null);
    this.bag = bag;
    this.first = bag.frames[0].time;
    this.last = bag.frames.at(-1).time;
    this.parts.scrub.max = bag.frames.length - 1;
    for (const id of ["play", "speed", "scrub"]) this.parts[id].disabled = false;
    this.parts.live.hidden = false;
    const length = Math.max(this.last - this.first, 1e-6);
    this.parts.marks.replaceChildren(...marks(bag.journal, this.first, length).map(({ entry, more }) => {
      const others = more ? ` (and ${more} more nearby)` : "";
      const mark = element("button", { type: "button", class: "mark", "data-level": entry.level, title: `${clock(entry.time - this.first)}  ${entry.title.replaceAll("_", " ")}: ${entry.text}${others}`, tabIndex: -1 });
      mark.style.left = `${(100 * (entry.time - this.first)) / length}%`;
      mark.addEventListener("click", () => this.goTo(entry.time));
      return mark;
    }));
    this.onOpen(this);
    this.go(0);
  }

  close() {
    this.play(false);
    this.bag = null;
    this.parts.bags.value = "";
    for (const id of ["play", "speed", "scrub"]) this.parts[id].disabled = true;
    this.parts.live.hidden = true;
    this.parts.marks.replaceChildren();
    setText(this.parts["replay-time"], "");
    this.onClose();
  }

  goTo(time) {
    const index = this.bag.frames.findIndex((frame) => frame.time >= time);
    this.go(index < 0 ? this.bag.frames.length - 1 : index);
  }

  go(index) {
    this.index = Math.max(0, Math.min(index, this.bag.frames.length - 1));
    this.parts.scrub.value = this.index;
    this.showTime();
    this.onFrame(this.bag.frames[this.index], this);
  }

  showTime() {
    const frame = this.bag?.frames[this.index];
    setText(this.parts["replay-time"], frame ? `${clock(frame.time - this.first)} of ${clock(this.last - this.first)}` : "");
  }

  play(isPlaying) {
    this.isPlaying = isPlaying && this.isOpen;
    setText(this.parts.play, this.isPlaying ? "pause" : "play");
    if (!this.isPlaying) return;
    if (this.index >= this.bag.frames.length - 1) this.go(0);
    let shown = this.bag.frames[this.index].time;
    let before = performance.now();
    const step = (now) => {
      if (!this.isPlaying || !this.isOpen) return;
      if (document.hidden === false || now - before < 1000) shown += ((now - before) / 1000) * Number(this.parts.speed.value);
      before = now;
      let index = this.index;
      while (index < this.bag.frames.length - 1 && this.bag.frames[index + 1].time <= shown) index++;
      if (index !== this.index) this.go(index);
      if (this.index >= this.bag.frames.length - 1) this.play(false);
      else requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }
}

// Of entries close together show the most severe one.
function marks(journal, first, length) {
  const places = new Map();
  for (const entry of journal) {
    const place = Math.floor((MAX_MARKS * (entry.time - first)) / length);
    const there = places.get(place);
    if (!there) places.set(place, { entry, more: 0 });
    else {
      there.more += 1;
      if (RANKS.indexOf(entry.level) > RANKS.indexOf(there.entry.level)) there.entry = entry;
    }
  }
  return [...places.values()];
}
