// A canvas with a world on it: metres to pixels and back, pan and zoom by mouse, wheel, fingers and keys.
const ROOM = 24;
class View {
  constructor(canvas, changed) {
    this.canvas = canvas; this.changed = changed;
    this.x = 0; this.y = 0; this.scale = 1; this.width = 1; this.height = 1; this.ratio = 1;
    this.home = null; this.touched = false; this.clicked = null; this.fingers = new Map();
    canvas.addEventListener("wheel", (e) => {
      e.preventDefault();
      this.zoom(Math.exp(-e.deltaY * (e.deltaMode ? 0.05 : 0.0015)), e.offsetX, e.offsetY);
    }, { passive: false });
    canvas.addEventListener("pointerdown", (e) => this.down(e));
    canvas.addEventListener("pointermove", (e) => this.move(e));
    for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, (e) => this.up(e, kind));
  }

  /** Take the size the page gives; true if it changed. */
  resize() {
    const box = this.canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
    const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
    if (width === this.canvas.width && height === this.canvas.height && ratio === this.ratio) return false;
    this.canvas.width = width; this.canvas.height = height;
    this.width = box.width; this.height = box.height; this.ratio = ratio;
    if (this.home && !this.touched) this.fit(this.home);
    return true;
  }

  /** Show a box {x0, y0, x1, y1} with a margin in which marks at its edge and their numbers have room. */
  fit(box) {
    this.home = box; this.touched = false;
    const w = Math.max(box.x1 - box.x0, 1e-3), h = Math.max(box.y1 - box.y0, 1e-3);
    const inner = (size) => Math.max(Math.min(0.92 * size, size - 2 * ROOM), 1);
    this.scale = Math.min(inner(this.width) / w, inner(this.height) / h);
    this.x = (box.x0 + box.x1) / 2; this.y = (box.y0 + box.y1) / 2;
  }

  px(x) { return (x - this.x) * this.scale + this.width / 2; }
  py(y) { return this.height / 2 - (y - this.y) * this.scale; }

  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const wx = this.x + (px - this.width / 2) / this.scale, wy = this.y - (py - this.height / 2) / this.scale;
    this.scale = Math.min(Math.max(this.scale * factor, 1e-3), 1e5);
    this.x = wx - (px - this.width / 2) / this.scale; this.y = wy + (py - this.height / 2) / this.scale;
    this.touched = true; this.changed();
  }

  pan(dx, dy) { this.x -= dx / this.scale; this.y += dy / this.scale; this.touched = true; this.changed(); }

  down(e) {
    this.canvas.setPointerCapture(e.pointerId);
    this.fingers.set(e.pointerId, { x: e.offsetX, y: e.offsetY });
    this.far = 0;
  }

  move(e) {
    const finger = this.fingers.get(e.pointerId);
    if (!finger) return;
    const dx = e.offsetX - finger.x, dy = e.offsetY - finger.y;
    const others = [...this.fingers.entries()].filter(([id]) => id !== e.pointerId).map(([, at]) => at);
    if (others.length) {
      const o = others[0], before = Math.hypot(finger.x - o.x, finger.y - o.y);
      finger.x = e.offsetX; finger.y = e.offsetY;
      const now = Math.hypot(finger.x - o.x, finger.y - o.y);
      if (before > 5) this.zoom(now / before, (finger.x + o.x) / 2, (finger.y + o.y) / 2);
      this.pan(dx / 2, dy / 2);
      this.far = 99;
      return;
    }
    this.far += Math.hypot(dx, dy);
    if (this.far < 4) return;
    finger.x = e.offsetX; finger.y = e.offsetY;
    this.pan(dx, dy);
  }

  up(e, kind) {
    const was = this.fingers.delete(e.pointerId);
    if (was && kind === "pointerup" && this.far < 4 && this.clicked) this.clicked(e.offsetX, e.offsetY);
  }
}
