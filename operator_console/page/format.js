// Numbers and times as text; a dash stands for an unknown value.

export function number(value, digits) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  // Use a minus sign of digit width; avoid "-0.0".
  const text = value.toFixed(digits);
  return (Number(text) === 0 ? (0).toFixed(digits) : text).replace("-", "−");
}

export function age(seconds) {
  if (seconds === null || seconds === undefined) return "no data";
  if (seconds < 10) return `${seconds.toFixed(1)} s old`;
  if (seconds < 120) return `${Math.round(seconds)} s old`;
  if (seconds < 7200) return `${Math.round(seconds / 60)} min old`;
  return `${Math.round(seconds / 3600)} h old`;
}

export function clock(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  const whole = Math.floor(Math.abs(seconds));
  const parts = [Math.floor(whole / 60) % 60, whole % 60];
  if (whole >= 3600) parts.unshift(Math.floor(whole / 3600));
  const text = parts.map((part) => String(part).padStart(2, "0")).join(":");
  return (seconds < 0 ? "−" : "") + text;
}

// Machine time: from 0 in simulation, time of day in UTC on hardware.
export function machineTime(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  return seconds > 1e9 ? `${new Date(seconds * 1000).toISOString().slice(11, 19)}Z` : clock(seconds);
}

export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name === "class") made.className = value;
    else if (name.startsWith("data-") || name.startsWith("aria-") || name === "for") made.setAttribute(name, value);
    else made[name] = value;
  }
  made.append(...children);
  return made;
}

export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

export const LEVELS = ["ok", "warn", "error", "stale"];
export const SIGNS = { ok: "✓", warn: "▲", error: "✕", stale: "?", unknown: "?" };
