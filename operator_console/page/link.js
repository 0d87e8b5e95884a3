// The connection to the console server: reports a loss and reconnects by itself.

const FRAME_TIMEOUT = 800; // [ms] without a frame until the page is stale; frames arrive at 4 Hz or more
const CHECK_PERIOD = 100;
const FIRST_RETRY = 500;
const LONGEST_RETRY = 5000;

export class Link {
  constructor({ onContent, onState }) {
    this.onContent = onContent;
    this.onState = onState;
    this.state = "lost";
    this.receivedAt = null;
    this.retry = FIRST_RETRY;
    this.waiting = new Map();
    this.count = 0;
    setInterval(() => this.check(), CHECK_PERIOD);
    this.open();
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/live`);
    this.socket = socket;
    socket.onopen = () => { this.retry = FIRST_RETRY; };
    socket.onmessage = (event) => this.receive(JSON.parse(event.data));
    socket.onclose = () => {
      if (this.socket !== socket) return;
      this.fail("the connection was lost before the answer: check the state");
      this.set("lost");
      setTimeout(() => this.open(), this.retry);
      this.retry = Math.min(2 * this.retry, LONGEST_RETRY);
    };
  }

  receive(content) {
    if (content.kind === "frame") {
      this.receivedAt = performance.now();
      this.set("live");
    }
    if (content.kind === "outcome" && this.waiting.has(content.id)) {
      this.waiting.get(content.id)(content);
      this.waiting.delete(content.id);
    }
    this.onContent(content);
  }

  check() {
    if (this.state === "live" && performance.now() - this.receivedAt > FRAME_TIMEOUT) this.set("silent");
    if (this.state !== "live") this.onState(this.state, this.frameAge());
  }

  // Age of the last frame [s]; null before the first.
  frameAge() {
    return this.receivedAt === null ? null : (performance.now() - this.receivedAt) / 1000;
  }

  set(state) {
    if (state === this.state) return;
    this.state = state;
    this.onState(state, this.frameAge());
  }

  // Send a command; the promise resolves to its outcome and never rejects.
  command(name, values) {
    return this.request(name, { arguments: values });
  }

  // Report that a button is still pressed; the promise resolves to whether the command continues.
  renew(name, press) {
    return this.request(name, { renew: press });
  }

  request(name, content) {
    const id = ++this.count;
    return new Promise((resolve) => {
      if (this.socket.readyState !== WebSocket.OPEN) {
        resolve({ name, done: false, reason: "no connection to the console server: nothing was sent" });
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
