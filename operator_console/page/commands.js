// The operators' commands. Those that move something need confirmation; a refusal shows its reason. A
// command that must be renewed lasts while its button is pressed.

import { element, number, setText } from "./format.js";

const HEAD = new Set(["hold", "abort"]); // in the header, without confirmation
const TITLES = { everything: "whole machine", descent: "descent", winch: "winch only", jump: "jump", mission: "mission", simulation: "simulation" };
const box = document.getElementById("confirm"); // lies below the form whose command it confirms

export class Commands {
  // send(name, values): a promise of the outcome. now(): the state to show in the confirmation.
  // renew(name, press): a promise of whether the command continues.
  constructor({ send, renew, now }) {
    this.send = send;
    this.renew = renew;
    this.now = now;
    this.enabled = false;
    this.stops = false;
    this.pressed = null;
    this.note = "";
    this.moving = []; // names of the commands that move something
    this.confirming = ""; // the command whose confirmation is open
    this.list = document.getElementById("command-list");
    this.answer = document.getElementById("answer");
    this.answer.addEventListener("click", () => { this.answer.hidden = true; });
    this.obstacles = {};
    document.addEventListener("keydown", (event) => {
      if (event.key === "Escape" && !event.repeat) this.execute({ name: "hold", arguments: [] }, {});
    });
    for (const name of HEAD) {
      document.getElementById(name).addEventListener("click", () => this.execute({ name, arguments: [] }, {}));
    }
  }

  fill(rows) {
    cancelConfirmation();
    const groups = Map.groupBy ? Map.groupBy(rows, (row) => row.group) : groupBy(rows);
    this.list.replaceChildren(...[...groups].map(([group, members]) => {
      const forms = members.filter((row) => !HEAD.has(row.name)).map((row) => this.form(row));
      const isUsual = group === "everything" || group === "descent";
      return element("details", { open: isUsual, "data-group": group },
        element("summary", {}, TITLES[group] ?? group, element("span", { class: "why" })), ...forms);
    }));
    this.moving = rows.filter((row) => row.moves).map((row) => row.name);
    this.enable(this.enabled, this.note, this.stops);
  }

  form(row) {
    const inputs = row.arguments.map((argument) => {
      const id = `argument-${row.name}-${argument.name}`;
      const input = element("input", { id, name: argument.name, inputMode: "decimal", autocomplete: "off", placeholder: argument.required ? "" : "default" });
      input.size = 6;
      const range = `${short(argument.minimum)} … ${short(argument.maximum)} ${argument.unit}`;
      input.title = `${argument.about}: ${range}`;
      input.setAttribute("aria-label", `${row.name} ${argument.name} in ${argument.unit}`);
      return element("label", { for: id, title: input.title }, element("span", {}, argument.name), input, element("i", {}, argument.unit));
    });
    const isDeadman = row.renewal_rate > 0;
    const button = element("button", { type: isDeadman ? "button" : "submit", "data-command": row.name, title: row.about }, isDeadman ? `press to ${row.name}` : row.name);
    const problem = element("p", { class: "problem", hidden: true });
    const form = element("form", { class: inputs.length ? "command" : "command plain", title: row.about, noValidate: true }, button, ...inputs, problem);
    const withValues = (action) => {
      problem.hidden = true;
      try {
        action(read(row, new FormData(form)));
      } catch (error) {
        problem.textContent = error.message;
        problem.hidden = false;
      }
    };
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      if (!isDeadman) withValues((values) => this.confirmAndSend(row, values, form));
    });
    if (isDeadman) {
      button.classList.add("deadman");
      button.addEventListener("pointerdown", (event) => { if (event.button === 0) withValues((values) => this.press(row, values, button)); });
      button.addEventListener("contextmenu", (event) => event.preventDefault());
      button.addEventListener("keydown", (event) => { if (event.key === " " && !event.repeat) withValues((values) => this.press(row, values, button)); });
    }
    return form;
  }

  // Lasts until the button is released, the page is hidden, or the server refuses a renewal.
  async press(row, values, button) {
    if (!this.enabled || this.pressed || this.obstacles[row.name]) return;
    cancelConfirmation();
    const pressed = { timer: 0, isOver: false };
    this.pressed = pressed;
    button.dataset.pressed = "";
    const over = new AbortController();
    const letGo = async () => {
      if (pressed.isOver) return;
      this.release(pressed, over, button);
      await this.execute({ name: "hold", arguments: [] }, {});
    };
    for (const name of ["pointerup", "pointercancel", "blur", "keyup", "pagehide"]) window.addEventListener(name, letGo, { signal: over.signal });
    document.addEventListener("visibilitychange", letGo, { signal: over.signal });
    const text = orderText(row, values);
    this.show("…", text, "sent, waiting for the answer", "waiting");
    const outcome = await this.send(row.name, values);
    if (!outcome.done) {
      this.release(pressed, over, button);
      return this.showFailure(text, outcome);
    }
    // The button was released before the answer arrived: stop now.
    if (pressed.isOver) return this.execute({ name: "hold", arguments: [] }, {});
    this.show("✓", `${text}: lasts while you press the button`, outcome.reason ?? "", "ok");
    pressed.timer = setInterval(async () => {
      const renewed = await this.renew(row.name, outcome.press);
      if (renewed.done || pressed.isOver) return;
      this.release(pressed, over, button);
      this.showFailure(text, renewed);
    }, 1000 / row.renewal_rate);
  }

  release(pressed, over, button) {
    pressed.isOver = true;
    clearInterval(pressed.timer);
    over.abort();
    delete button.dataset.pressed;
    this.pressed = null;
  }

  async confirmAndSend(row, values, form) {
    this.confirming = row.name;
    if (row.moves && !(await confirm(row, values, this.now(), form))) return;
    await this.execute(row, values);
  }

  async execute(row, values) {
    cancelConfirmation();
    if (this.obstacles[row.name]) return this.show("✕", `${row.name} was not sent`, this.obstacles[row.name], "error");
    if (!(HEAD.has(row.name) ? this.stops : this.enabled)) return this.show("✕", `${row.name} was not sent`, this.note, "error");
    const text = orderText(row, values);
    this.show("…", text, "sent, waiting for the answer", "waiting");
    const outcome = await this.send(row.name, values);
    if (outcome.done) return this.show("✓", `${text}: accepted`, outcome.reason ?? "", "ok");
    return this.showFailure(text, outcome);
  }

  // Show that a command was refused or has ended, with the reason.
  showFailure(text, outcome) {
    const word = outcome.status ?? (outcome.unknown ? "unknown" : "refused");
    const code = outcome.code ? ` [${outcome.code}]` : "";
    return this.show("✕", `${text}: ${word}`, `${outcome.reason}${code}`, "error");
  }

  show(sign, title, text, level) {
    this.answer.hidden = false;
    this.answer.dataset.level = level;
    this.answer.replaceChildren(element("span", { class: "sign", "aria-hidden": "true" }, sign),
      element("div", {}, element("b", {}, title), element("span", {}, text)));
  }

  // note: why commands are disabled. stops: whether HOLD and ABORT are enabled.
  enable(enabled, note, stops) {
    this.enabled = enabled;
    this.note = note;
    this.stops = stops;
    for (const button of document.querySelectorAll("#stops button")) button.disabled = !stops;
    for (const input of this.list.querySelectorAll("input")) input.disabled = !enabled;
    if (!enabled) cancelConfirmation();
    this.offer();
  }

  // obstacles: why commands may not be sent now, by name.
  setObstacles(obstacles) {
    this.obstacles = obstacles;
    if (obstacles[this.confirming]) cancelConfirmation();
    this.offer();
  }

  offer() {
    const reasons = new Set(this.moving.map((name) => this.obstacles[name] ?? ""));
    const [common] = reasons.size === 1 ? reasons : [""];
    setText(document.getElementById("commands-note"), this.enabled ? common && `nothing may move: ${common}` : this.note);
    for (const button of this.list.querySelectorAll("[data-command]")) {
      const why = this.obstacles[button.dataset.command] ?? "";
      button.disabled = !this.enabled || Boolean(why);
      button.title = why || button.form.title;
    }
    for (const group of this.list.querySelectorAll("details")) {
      const names = [...group.querySelectorAll("[data-command]")].map((button) => button.dataset.command);
      const why = common ? "" : names.map((name) => this.obstacles[name]).find(Boolean);
      setText(group.querySelector(".why"), why ?? "");
    }
  }
}

function read(row, data) {
  const values = {};
  for (const argument of row.arguments) {
    const text = String(data.get(argument.name) ?? "").trim().replace(",", ".").replace("−", "-");
    if (!text && !argument.required) continue;
    const value = Number(text);
    const range = `${short(argument.minimum)} to ${short(argument.maximum)} ${argument.unit}`;
    if (!text || !Number.isFinite(value)) throw new Error(`${argument.name}: give a number, ${range}`);
    if (value < argument.minimum || value > argument.maximum) throw new Error(`${argument.name}: ${short(value)} is outside ${range}`);
    values[argument.name] = value;
  }
  return values;
}

function orderText(row, values) {
  const parts = row.arguments.filter(({ name }) => name in values).map(({ name, unit }, index) =>
    `${index ? `${name} ` : ""}${short(values[name])} ${unit}`);
  return [row.name, ...parts].join(" ");
}

// Asks below the command's form, in front of nothing. Another command, or anything that ends the
// question, cancels it.
function confirm(row, values, now, form) {
  document.getElementById("confirm-title").textContent = `${orderText(row, values)}?`;
  document.getElementById("confirm-text").textContent = `${row.name}: ${row.about}.`;
  document.getElementById("confirm-now").textContent = now;
  const [yes, no] = [document.getElementById("confirm-yes"), document.getElementById("confirm-no")];
  yes.textContent = `Send: ${orderText(row, values)}`;
  cancelConfirmation();
  form.after(box);
  box.hidden = false;
  no.focus({ preventScroll: true });
  box.scrollIntoView({ block: "nearest" });
  return new Promise((resolve) => {
    const answer = (isConfirmed) => {
      box.hidden = true;
      over.abort();
      resolve(isConfirmed);
    };
    const over = new AbortController();
    yes.addEventListener("click", () => answer(true), { signal: over.signal });
    no.addEventListener("click", () => answer(false), { signal: over.signal });
    box.addEventListener("cancel", () => answer(false), { signal: over.signal });
  });
}

function cancelConfirmation() {
  box.dispatchEvent(new Event("cancel"));
}

// As few digits as possible.
function short(value) {
  return number(value, Math.abs(value) >= 1000 || Number.isInteger(value) ? 0 : 3).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "");
}

function groupBy(rows) {
  const groups = new Map();
  for (const row of rows) groups.set(row.group, [...(groups.get(row.group) ?? []), row]);
  return groups;
}
