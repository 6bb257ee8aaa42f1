// The part of the plane that a canvas shows, changed by wheel, drag, pinch, keys and buttons.
class View {
  constructor(canvas, changed) {
    Object.assign(this, { canvas, changed, x: 0, y: 0, scale: 1, home: [0, 1, 0, 1], touched: false });
    const fingers = new Map();
    canvas.addEventListener("wheel", (event) => {
      // the page scrolls unless the map has the focus
      if (!event.ctrlKey && !canvas.parentElement.contains(document.activeElement)) return;
      event.preventDefault();
      this.zoom(Math.exp(-0.0015 * event.deltaY), event.offsetX, event.offsetY);
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!fingers.has(event.pointerId)) return;
      const old = fingers.get(event.pointerId);
      const now = [event.offsetX, event.offsetY];
      const other = [...fingers.keys()].find((id) => id !== event.pointerId);
      fingers.set(event.pointerId, now);
      if (other === undefined) this.pan(now[0] - old[0], now[1] - old[1]);
      else {
        const fixed = fingers.get(other);
        const apart = (a) => Math.max(Math.hypot(a[0] - fixed[0], a[1] - fixed[1]), 1);
        this.zoom(apart(now) / apart(old), fixed[0], fixed[1]);
      }
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
  }

  get size() { return [this.canvas.clientWidth, this.canvas.clientHeight]; }

  toScreen(x, y) {
    const [width, height] = this.size;
    return [width / 2 + (x - this.x) * this.scale, height / 2 - (y - this.y) * this.scale];
  }

  fit(xMin, xMax, yMin, yMax) {
    const [width, height] = this.size;
    this.home = [xMin, xMax, yMin, yMax];
    this.x = (xMin + xMax) / 2;
    this.y = (yMin + yMax) / 2;
    this.scale = 0.96 * Math.min(width / Math.max(xMax - xMin, 0.1), height / Math.max(yMax - yMin, 0.1));
    this.touched = false;
    this.changed();
  }

  pan(right, down) {
    this.x -= right / this.scale;
    this.y += down / this.scale;
    this.touched = true;
    this.changed();
  }

  // The point under (px, py) stays where it is.
  zoom(factor, px = this.size[0] / 2, py = this.size[1] / 2) {
    const [width, height] = this.size;
    const scale = Math.min(Math.max(this.scale * factor, 1), 5000);
    this.x += (px - width / 2) * (1 / this.scale - 1 / scale);
    this.y -= (py - height / 2) * (1 / this.scale - 1 / scale);
    this.scale = scale;
    this.touched = true;
    this.changed();
  }

  // The largest round length (m) of at most a quarter of the width.
  get bar() {
    const quarter = this.size[0] / this.scale / 4;
    const power = 10 ** Math.floor(Math.log10(quarter));
    return Math.max(...[1, 2, 5].map((step) => step * power).filter((length) => length <= quarter));
  }
}
