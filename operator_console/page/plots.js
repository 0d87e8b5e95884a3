// Plots of recent values or of a whole bag, with a common time axis and cursor.

import { machineTime, number } from "./format.js";

const KEY = "console";
const TITLE = 20; // [px]
const STEPS = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 21600]; // [s]
const SHORTEST = 20; // [s]

export const PLOTS = [
  { title: "depth [m]", down: true, digits: 2, least: 1, series: [["depth", "depth"], ["depth_goal", "goal", [6, 4]]] },
  { title: "tension at the fairlead [N]", digits: 1, least: 2, series: [["tension", "tension"]] },
  { title: "swing [deg]", digits: 2, least: 0.5, series: [["swing_major", "major"], ["swing_minor", "minor", [6, 4]]] },
  { title: "budgets [%]", digits: 0, limits: [-100, 100], series: [["wheels_budget", "wheels"], ["flywheel_budget", "flywheel", [6, 4]], ["travel_budget", "screw travel", [2, 3]]] },
];
const COLOURS = ["series1", "series2", "series3"];

export class Plots {
  constructor(root, onPick) {
    this.root = root;
    this.window = 300;
    this.columns = { time: [] };
    this.names = PLOTS.flatMap((plot) => plot.series.map(([name]) => name));
    for (const name of this.names) this.columns[name] = [];
    this.onPick = onPick;
    this.build();
    new ResizeObserver(() => this.resize()).observe(root);
  }

  build() {
    for (const plot of this.plots ?? []) plot.destroy();
    this.root.replaceChildren();
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    this.plots = PLOTS.map((plot) => {
      const axis = { stroke: colour("faint-text"), grid: { stroke: colour("grid"), width: 1 }, ticks: { stroke: colour("grid"), width: 1, size: 5 }, font: "11px system-ui, sans-serif" };
      const made = new uPlot({
        width: Math.max(200, this.root.clientWidth - 14),
        height: this.height(),
        title: plot.title,
        cursor: { sync: { key: KEY }, drag: { x: false, y: false } },
        legend: { live: true },
        scales: { x: { time: false }, y: { dir: plot.down ? -1 : 1, range: (_, low, high) => span(low, high, plot) } },
        axes: [
          { ...axis, size: 24, gap: 2, values: (_, ticks) => ticks.map(machineTime), space: 80, incrs: STEPS },
          { ...axis, size: 48, space: 24, values: (_, ticks) => ticks.map((tick) => number(tick, decimals(ticks))) },
        ],
        series: [
          { label: "time", value: (_, value) => machineTime(value) },
          ...plot.series.map(([, label, dash], index) => ({
            label, dash, stroke: colour(COLOURS[index]), width: 2, spanGaps: false, points: { show: false },
            value: (_, value) => (value === null || value === undefined ? "" : number(value, plot.digits)),
          })),
        ],
        hooks: plot.limits ? { draw: [(u) => drawLimits(u, plot.limits, colour("error"))] } : {},
      }, [[], ...plot.series.map(() => [])], this.root);
      made.over.addEventListener("click", () => {
        if (made.cursor.left >= 0) this.onPick(made.posToVal(made.cursor.left, "x"));
      });
      return made;
    });
    this.draw();
  }

  // Append a live frame.
  add(frame) {
    const times = this.columns.time;
    if (times.length && frame.time < times.at(-1)) this.clear(); // the clock restarts
    if (times.length && frame.time === times.at(-1)) return;
    times.push(frame.time);
    for (const name of this.names) this.columns[name].push(known(frame.values[name]));
    const first = frame.time - 960;
    if (times[0] < first - 60) {
      const drop = times.findIndex((time) => time >= first);
      for (const column of Object.values(this.columns)) column.splice(0, drop);
    }
  }

  // Replace the values, by the history or by a bag.
  fill(frames) {
    this.clear();
    for (const frame of frames) {
      this.columns.time.push(frame.time);
      for (const name of this.names) this.columns[name].push(known(frame.values[name]));
    }
  }

  clear() {
    for (const column of Object.values(this.columns)) column.length = 0;
  }

  // range: limits of the time axis; null: the recent values. marker: time of the vertical line.
  draw(range = this.range ?? null, marker = null) {
    this.range = range;
    const times = this.columns.time;
    const end = times.at(-1) ?? 0;
    const start = Math.min(Math.max(end - this.window, times[0] ?? 0), end - SHORTEST);
    const [low, high] = range ?? [start, end];
    const first = Math.max(0, lowerBound(times, low) - 1);
    const shown = times.slice(first);
    PLOTS.forEach((plot, index) => {
      const made = this.plots[index];
      made.batch(() => {
        made.setData([shown, ...plot.series.map(([name]) => this.columns[name].slice(first))], false);
        made.setScale("x", { min: low, max: high });
      });
      this.point(made, marker);
    });
  }

  point(plot, time) {
    let line = plot.over.querySelector(".now-line");
    if (!line) {
      line = document.createElement("div");
      line.className = "now-line";
      plot.over.append(line);
    }
    line.hidden = time === null;
    if (time !== null) line.style.left = `${plot.valToPos(time, "x")}px`;
  }

  resize() {
    const width = Math.max(200, this.root.clientWidth - 14);
    const height = this.height();
    for (const plot of this.plots) if (plot.width !== width || plot.height !== height) plot.setSize({ width, height });
  }

  // The plots fill the panel.
  height() {
    return Math.max(80, Math.floor((this.root.clientHeight - 10) / PLOTS.length) - TITLE);
  }
}

function known(value) {
  return value && !value[2] ? value[0] : null;
}

function lowerBound(times, time) {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] < time) low = middle + 1; else high = middle;
  }
  return low;
}

function decimals(ticks) {
  const step = ticks.length > 1 ? Math.abs(ticks[1] - ticks[0]) : 1;
  return step < 0.1 ? 2 : step < 1 ? 1 : 0;
}

// Limits of the value axis, at least `least` apart so that noise does not fill the plot.
function span(low, high, { limits, least }) {
  if (limits) { // cut far beyond them: a jump moves the screw by ten times its budget
    const [lowest, highest] = limits.map((limit) => 1.5 * limit);
    return [Math.max(lowest, Math.min(limits[0] * 1.1, low ?? 0)), Math.min(highest, Math.max(limits[1] * 1.1, high ?? 0))];
  }
  if (low === null || low === undefined) return [0, 1];
  const margin = Math.max(0.08 * (high - low), 0.5 * (least - (high - low)));
  return [low - margin, high + margin];
}

function drawLimits(plot, limits, colour) {
  const pen = plot.ctx;
  pen.save();
  pen.strokeStyle = colour;
  pen.lineWidth = devicePixelRatio;
  pen.setLineDash([4 * devicePixelRatio, 4 * devicePixelRatio]);
  for (const limit of limits) {
    const y = plot.valToPos(limit, "y", true);
    pen.beginPath();
    pen.moveTo(plot.bbox.left, y);
    pen.lineTo(plot.bbox.left + plot.bbox.width, y);
    pen.stroke();
  }
  pen.restore();
}
