// Side and top view of hole, tether and rover, to scale [m].

import { number } from "./format.js";

const NEAR = 1.6; // smallest half height of the near view [m]
const SLACK = 0.3; // tether below this tension is drawn slack [N]
const TRAIL = 90; // duration of the drawn track [s]

export class View {
  // axes: indices of the coordinates to the right and up.
  constructor(canvas, axes) {
    this.canvas = canvas;
    this.axes = axes;
    this.extent = axes[1] === 2 ? "whole" : "near";
    this.place = null;
    this.machine = null;
    this.trail = [];
    this.shown = null;
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  set(name, value) {
    this[name] = value;
    this.draw();
  }

  // frame: frame to show; isOld: whether no new frames arrive.
  show(frame, isOld) {
    const rover = roverOf(frame?.geometry);
    if (rover && !isOld && frame.geometry.source === "simulation") {
      const time = frame.time;
      const last = this.trail.at(-1);
      if (last && (time < last.time || time - last.time > 5)) this.trail = [];
      if (!last || time - last.time > 0.2) this.trail.push({ time, at: rover });
      while (this.trail.length && time - this.trail[0].time > TRAIL) this.trail.shift();
    }
    this.shown = frame;
    this.isOld = isOld;
    this.draw();
  }

  draw() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const ratio = window.devicePixelRatio || 1;
    if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(height * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
    }
    const pen = this.canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    const style = getComputedStyle(document.documentElement);
    this.colour = (name) => style.getPropertyValue(`--${name}`).trim();
    pen.font = "12px system-ui, sans-serif";
    this.pen = pen;
    this.size = [width, height];
    const geometry = this.shown?.geometry;
    const rover = roverOf(geometry);
    this.fit(rover);
    this.drawPlace(rover);
    if (this.isSide) this.drawDepths(rover);
    if (!geometry) {
      this.note("no position received");
      return;
    }
    pen.globalAlpha = this.isOld || geometry.stale ? 0.4 : 1;
    this.drawTrail();
    if (this.isSide) this.drawGoal();
    this.drawTether(geometry);
    this.drawRover(geometry, rover);
    pen.globalAlpha = 1;
    this.drawScale();
    const where = this.isSide ? `depth ${number(-rover[2], 2)} m` : `x ${number(rover[0], 2)} m, y ${number(rover[1], 2)} m`;
    this.canvas.setAttribute("aria-label", `${this.isSide ? "side" : "top"} view: rover at ${where}`);
  }

  get isSide() { return this.axes[1] === 2; }

  // ---- transformation between metres and pixels

  fit(rover) {
    const [width, height] = this.size;
    const at = rover ?? [0, 0, -5];
    if (this.extent === "near") {
      let half = NEAR;
      if (!this.isSide) {
        const reach = this.trail.map(({ at: p }) => Math.max(Math.abs(p[0] - at[0]), Math.abs(p[1] - at[1])));
        half = Math.max(0.5, 1.25 * Math.max(0, ...reach));
      }
      this.scale = Math.min(width, height) / (2 * half);
      this.centre = [at[this.axes[0]], at[this.axes[1]]];
      this.origin = [width / 2, height / 2];
      return;
    }
    const box = this.box(at);
    this.scale = Math.min((width - 60) / (box[2] - box[0]), (height - 34) / (box[3] - box[1]));
    if (this.isSide) this.scale = (height - 34) / (box[3] - box[1]);
    this.centre = [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2];
    if (this.isSide) this.centre[0] = this.sideCentre(width, at);
    this.origin = [width / 2, height / 2 + 4];
  }

  // A wide hole does not fit into a narrow view: show the tether and the nearer wall.
  sideCentre(width, at) {
    const half = width / 2 / this.scale;
    const walls = this.place ? this.place.wall.filter((line) => Math.abs(line[1] + 10) < 40).flatMap((line) => [line[0], line[2]]) : [];
    const nearest = walls.reduce((best, x) => (Math.abs(x) < Math.abs(best) ? x : best), 1e9);
    if (Math.abs(nearest) > half * 1.5) return at[0] / 2;
    return Math.sign(nearest) * Math.max(0, Math.abs(nearest) + 0.12 * half - half) * 1 + (Math.abs(nearest) < half ? Math.sign(-nearest) * 0.35 * half : 0);
  }

  // Bounding box of the whole view: minimum right, minimum up, maximum right, maximum up.
  box(at) {
    const lines = this.isSide ? [...(this.place?.wall ?? []), ...(this.place?.floor ?? [])] : this.outline(at)?.lines ?? [];
    if (!lines.length) {
      const depth = Math.max(10, -at[2] * 1.15);
      return this.isSide ? [-depth / 2, -depth, depth / 2, 1.5] : [-3, -3, 3, 3];
    }
    const box = [Infinity, Infinity, -Infinity, -Infinity];
    for (const line of lines) {
      for (const [x, y] of [[line[0], line[1]], [line[2], line[3]]]) {
        box[0] = Math.min(box[0], x); box[1] = Math.min(box[1], y);
        box[2] = Math.max(box[2], x); box[3] = Math.max(box[3], y);
      }
    }
    if (this.isSide) { box[1] -= 1; box[3] = Math.max(box[3], 0) + 1.5; }
    return box;
  }

  outline(at) {
    const levels = this.place?.levels ?? [];
    return levels.reduce((best, level) => (!best || Math.abs(level.z - at[2]) < Math.abs(best.z - at[2]) ? level : best), null);
  }

  to(point) {
    return [
      this.origin[0] + (point[this.axes[0]] - this.centre[0]) * this.scale,
      this.origin[1] - (point[this.axes[1]] - this.centre[1]) * this.scale,
    ];
  }

  flat(x, y) {
    return [this.origin[0] + (x - this.centre[0]) * this.scale, this.origin[1] - (y - this.centre[1]) * this.scale];
  }

  // ---- drawing

  lines(lines, colour, width) {
    const pen = this.pen;
    pen.strokeStyle = this.colour(colour);
    pen.lineWidth = width;
    pen.lineCap = "round";
    pen.beginPath();
    for (const line of lines) {
      pen.moveTo(...this.flat(line[0], line[1]));
      pen.lineTo(...this.flat(line[2], line[3]));
    }
    pen.stroke();
  }

  drawPlace(rover) {
    const place = this.place;
    if (!place) return;
    const pen = this.pen;
    pen.fillStyle = this.colour("boulder");
    pen.strokeStyle = this.colour("wall");
    pen.lineWidth = 1;
    for (const [x, y, z, radius] of place.boulders) {
      const isNear = this.isSide ? Math.abs(y - (rover?.[1] ?? 0)) < 1.5 + radius : true;
      if (!isNear || radius * this.scale < 1) continue;
      pen.beginPath();
      pen.arc(...this.to([x, y, z]), radius * this.scale, 0, 2 * Math.PI);
      pen.fill();
      pen.stroke();
    }
    if (this.isSide) {
      this.lines(place.floor, "wall", 2.5);
      this.lines(place.wall, "wall", 3);
      return;
    }
    const outline = this.outline(rover ?? [0, 0, 0]);
    if (outline) this.lines(outline.lines, "wall", 3);
  }

  drawDepths(rover) {
    const pen = this.pen;
    const [width, height] = this.size;
    const step = niceStep(height / this.scale / 8);
    pen.fillStyle = this.colour("faint-text");
    pen.strokeStyle = this.colour("grid");
    pen.lineWidth = 1;
    pen.textAlign = "left";
    pen.textBaseline = "middle";
    const low = this.centre[1] - (height - this.origin[1]) / this.scale;
    const high = this.centre[1] + this.origin[1] / this.scale;
    for (let z = Math.ceil(low / step) * step; z <= high; z += step) {
      const y = this.flat(0, z)[1];
      if (y < 8 || y > height - 20) continue;
      pen.beginPath();
      pen.moveTo(46, y);
      pen.lineTo(width, y);
      pen.stroke();
      pen.fillText(`${number(-z, step < 1 ? 1 : 0)} m`, 4, y);
    }
    // The mother machine at the fairlead.
    const [x, y] = this.flat(0, 0);
    pen.fillStyle = this.colour("machine");
    pen.fillRect(x - 3, y - 5, 6, 5);
    pen.fillRect(x, y - 9, 20, 5);
    if (this.extent === "whole") {
      pen.textAlign = "left";
      pen.fillStyle = this.colour("faint-text");
      pen.fillText("fairlead", x + 24, y - 6);
    }
  }

  drawGoal() {
    const goal = this.shown.values?.depth_goal;
    if (!goal || goal[0] === null) return;
    const pen = this.pen;
    const y = this.flat(0, -goal[0])[1];
    const [width] = this.size;
    pen.strokeStyle = this.colour("goal");
    pen.lineWidth = 1.5;
    pen.setLineDash([7, 5]);
    pen.beginPath();
    pen.moveTo(46, y);
    pen.lineTo(width, y);
    pen.stroke();
    pen.setLineDash([]);
    pen.fillStyle = this.colour("goal");
    pen.textAlign = "right";
    pen.textBaseline = "bottom";
    this.text(`goal ${number(goal[0], 2)} m`, width - 6, y - 3);
  }

  drawTrail() {
    if (this.isSide && this.extent === "whole") return;
    const pen = this.pen;
    pen.strokeStyle = this.colour("trail");
    pen.lineWidth = 1.5;
    pen.beginPath();
    this.trail.forEach(({ at }, index) => pen[index ? "lineTo" : "moveTo"](...this.to(at)));
    pen.stroke();
  }

  drawTether(geometry) {
    const nodes = geometry.tether;
    if (!nodes?.length) return;
    const pen = this.pen;
    if (!this.isSide) {
      // The plumb line of the fairlead.
      const [x, y] = this.to([0, 0, 0]);
      pen.strokeStyle = this.colour("machine");
      pen.lineWidth = 2;
      pen.beginPath();
      pen.moveTo(x - 7, y); pen.lineTo(x + 7, y); pen.moveTo(x, y - 7); pen.lineTo(x, y + 7);
      pen.stroke();
    }
    pen.lineWidth = 2.5;
    pen.lineCap = "butt";
    const isSlack = (node) => node[3] !== null && node[3] < SLACK;
    // One line for each stretch that is slack or taut.
    for (let first = 0, last = 1; first < nodes.length - 1; first = last, last++) {
      const slack = isSlack(nodes[last]);
      while (last < nodes.length - 1 && isSlack(nodes[last + 1]) === slack) last++;
      pen.strokeStyle = this.colour(slack ? "slack" : "tether");
      pen.setLineDash(slack || geometry.source !== "simulation" ? [6, 5] : []);
      pen.beginPath();
      pen.moveTo(...this.to(nodes[first]));
      for (let index = first + 1; index <= last; index++) pen.lineTo(...this.to(nodes[index]));
      pen.stroke();
    }
    pen.setLineDash([]);
  }

  drawRover(geometry, rover) {
    const machine = this.machine;
    const pen = this.pen;
    if (machine && geometry.body1) {
      if (geometry.body2) this.box3(geometry.body2, machine.body2_size, "body2");
      this.box3(geometry.body1, machine.body1_size, "body1");
      this.wheels(geometry.body1, machine.wheels);
    }
    if (this.scale < 60) {
      const [x, y] = this.to(rover);
      pen.strokeStyle = this.colour("rover");
      pen.lineWidth = 2.5;
      pen.beginPath();
      pen.arc(x, y, 9, 0, 2 * Math.PI);
      pen.stroke();
      pen.fillStyle = this.colour("text");
      pen.textAlign = x > this.size[0] - 110 ? "right" : "left";
      pen.textBaseline = "middle";
      pen.font = "600 13px system-ui, sans-serif";
      this.text("rover", x + (pen.textAlign === "left" ? 15 : -15), y);
      pen.font = "12px system-ui, sans-serif";
    }
    if (!this.isSide && geometry.body1) {
      const forward = rotate(geometry.body1.slice(3), [1, 0, 0]);
      const [x, y] = this.to(rover);
      const reach = Math.max(24, 0.35 * this.scale);
      const heading = Math.atan2(-forward[1], forward[0]);
      pen.strokeStyle = pen.fillStyle = this.colour("rover");
      pen.lineWidth = 2;
      pen.beginPath();
      pen.moveTo(x, y);
      pen.lineTo(x + reach * Math.cos(heading), y + reach * Math.sin(heading));
      pen.stroke();
      pen.beginPath();
      const tip = [x + reach * Math.cos(heading), y + reach * Math.sin(heading)];
      pen.moveTo(tip[0] + 8 * Math.cos(heading), tip[1] + 8 * Math.sin(heading));
      pen.lineTo(tip[0] + 6 * Math.cos(heading + 2), tip[1] + 6 * Math.sin(heading + 2));
      pen.lineTo(tip[0] + 6 * Math.cos(heading - 2), tip[1] + 6 * Math.sin(heading - 2));
      pen.fill();
    }
  }

  // A box as the convex hull of its projected corners.
  box3(pose, size, colour) {
    const corners = [];
    for (const i of [-1, 1]) for (const j of [-1, 1]) for (const k of [-1, 1]) {
      const arm = rotate(pose.slice(3), [i * size[0] / 2, j * size[1] / 2, k * size[2] / 2]);
      corners.push(this.to([pose[0] + arm[0], pose[1] + arm[1], pose[2] + arm[2]]));
    }
    const pen = this.pen;
    const around = hull(corners);
    pen.beginPath();
    around.forEach((point, index) => pen[index ? "lineTo" : "moveTo"](...point));
    pen.closePath();
    pen.fillStyle = this.colour(colour);
    pen.strokeStyle = this.colour("text");
    pen.lineWidth = 1;
    pen.fill();
    pen.stroke();
  }

  wheels(pose, wheels) {
    if (!wheels) return;
    const pen = this.pen;
    pen.strokeStyle = this.colour("text");
    pen.lineWidth = 1.5;
    for (const side of [-1, 1]) {
      pen.beginPath();
      for (let step = 0; step <= 24; step++) {
        const angle = (step / 24) * 2 * Math.PI;
        const arm = rotate(pose.slice(3), [
          wheels.axle_x + wheels.radius * Math.cos(angle), side * wheels.track_width / 2,
          wheels.axle_z + wheels.radius * Math.sin(angle),
        ]);
        pen[step ? "lineTo" : "moveTo"](...this.to([pose[0] + arm[0], pose[1] + arm[1], pose[2] + arm[2]]));
      }
      pen.stroke();
    }
  }

  drawScale() {
    const pen = this.pen;
    const [width, height] = this.size;
    const length = niceStep(80 / this.scale);
    const x = width - 12 - length * this.scale;
    const y = height - 10;
    pen.strokeStyle = pen.fillStyle = this.colour("faint-text");
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(x, y - 4); pen.lineTo(x, y); pen.lineTo(x + length * this.scale, y); pen.lineTo(x + length * this.scale, y - 4);
    pen.stroke();
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    pen.fillText(`${length < 1 ? `${Math.round(length * 100)} cm` : `${length} m`}`, x - 6, y - 3);
    pen.textAlign = "left";
    pen.fillText(this.isSide ? "x →   z ↑" : "x →   y ↑", 6, height - 12);
  }

  // Text with a background outline.
  text(text, x, y) {
    this.pen.strokeStyle = this.colour("panel");
    this.pen.lineWidth = 4;
    this.pen.lineJoin = "round";
    this.pen.strokeText(text, x, y);
    this.pen.fillText(text, x, y);
  }

  note(text) {
    this.pen.fillStyle = this.colour("faint-text");
    this.pen.textAlign = "center";
    this.pen.textBaseline = "middle";
    this.pen.fillText(text, this.size[0] / 2, this.size[1] / 2);
  }
}

export function roverOf(geometry) {
  if (!geometry) return null;
  return geometry.body1 ?? geometry.tether?.at(-1) ?? null;
}

// Rotate a vector by a unit quaternion (x, y, z, w).
export function rotate([x, y, z, w], [a, b, c]) {
  const t = [2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)];
  return [
    a + w * t[0] + y * t[2] - z * t[1],
    b + w * t[1] + z * t[0] - x * t[2],
    c + w * t[2] + x * t[1] - y * t[0],
  ];
}

function hull(points) {
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const half = (list) => {
    const found = [];
    for (const point of list) {
      while (found.length > 1 && cross(found.at(-2), found.at(-1), point) <= 0) found.pop();
      found.push(point);
    }
    return found.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}

function cross(o, a, b) {
  return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]);
}

// The smallest 1, 2 or 5 times a power of ten that is not less.
function niceStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((step) => step * power).find((step) => step >= least);
}
