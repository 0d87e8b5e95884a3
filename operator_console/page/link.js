// The connection to the console's server: says when it is lost, and comes back by itself.

const SILENCE = 2500; // [ms] without a frame after which what is seen counts as old
const FIRST_RETRY = 500;
const LONGEST_RETRY = 5000;

export class Link {
  constructor({ onContent, onState }) {
    this.onContent = onContent;
    this.onState = onState;
    this.state = "lost";
    this.heardAt = null;
    this.retry = FIRST_RETRY;
    this.waiting = new Map();
    this.count = 0;
    setInterval(() => this.look(), 250);
    this.open();
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/live`);
    this.socket = socket;
    socket.onopen = () => { this.retry = FIRST_RETRY; };
    socket.onmessage = (event) => this.take(JSON.parse(event.data));
    socket.onclose = () => {
      if (this.socket !== socket) return;
      this.fail("the connection was lost before an answer came: look at what happened");
      this.set("lost");
      setTimeout(() => this.open(), this.retry);
      this.retry = Math.min(2 * this.retry, LONGEST_RETRY);
    };
  }

  take(content) {
    if (content.kind === "frame") {
      this.heardAt = performance.now();
      this.set("live");
    }
    if (content.kind === "outcome" && this.waiting.has(content.id)) {
      this.waiting.get(content.id)(content);
      this.waiting.delete(content.id);
    }
    this.onContent(content);
  }

  look() {
    if (this.state === "live" && performance.now() - this.heardAt > SILENCE) this.set("silent");
    if (this.state !== "live") this.onState(this.state, this.silence());
  }

  // Seconds since the last frame; null before the first.
  silence() {
    return this.heardAt === null ? null : (performance.now() - this.heardAt) / 1000;
  }

  set(state) {
    if (state === this.state) return;
    this.state = state;
    this.onState(state, this.silence());
  }

  // Sends a command; the promise bears its outcome and never fails.
  command(name, values) {
    return this.ask(name, { arguments: values });
  }

  // Says that a button is still held; the promise bears whether what it does goes on.
  renew(name, held) {
    return this.ask(name, { renews: held });
  }

  ask(name, content) {
    const id = ++this.count;
    return new Promise((resolve) => {
      if (this.socket.readyState !== WebSocket.OPEN) {
        resolve({ name, done: false, reason: "no connection to the console's server: nothing was sent" });
        return;
      }
      this.waiting.set(id, resolve);
      this.socket.send(JSON.stringify({ id, command: name, ...content }));
    });
  }

  fail(reason) {
    for (const resolve of this.waiting.values()) resolve({ done: false, unknown: true, reason });
    this.waiting.clear();
  }
}
