// Draws a quantity of all shown methods over time, with the cursor of the player; a click sets the time.
class Trace {
  constructor(canvas, recording, quantity, jump) {
    Object.assign(this, { canvas, recording, quantity, lines: new OffscreenCanvas(1, 1), margin: 52 });
    const seek = (event) => {
      const share = (event.offsetX - this.margin) / (canvas.clientWidth - this.margin - 8);
      jump(Math.min(Math.max(share, 0), 1) * recording.times.at(-1));
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      seek(event);
    });
    canvas.addEventListener("pointermove", (event) => event.buttons && seek(event));
  }

  // Called when the shown methods or the size change; the cursor alone needs only draw().
  prepare(runs) {
    const measured = runs.filter((run) => run[this.quantity]);
    const usual = measured.map((run) => upper(run[this.quantity]));
    this.wide = usual.length > 0 && Math.max(...usual) > 20 * Math.max(Math.min(...usual), 1e-3);
    this.most = 1.1 * measured.reduce((most, run) => run[this.quantity].reduce((a, b) => (b > a ? b : a), most), 1e-3);
    this.least = this.wide ? Math.max(Math.min(...usual) / 10, 1e-4) : 0;
    const brush = resized(this.canvas);
    this.axes(brush);
    for (const run of measured) this.line(brush, run);
    this.lines.width = this.canvas.width;
    this.lines.height = this.canvas.height;
    if (this.canvas.width) this.lines.getContext("2d").drawImage(this.canvas, 0, 0);
  }

  x(seconds1000) {
    return this.margin + (this.canvas.clientWidth - this.margin - 8) * seconds1000 / Math.max(this.recording.times.at(-1), 1);
  }

  y(value) {
    const height = this.canvas.clientHeight - 26;
    const part = this.wide
      ? Math.log(Math.max(value, this.least) / this.least) / Math.log(this.most / this.least)
      : value / this.most;
    return 8 + height * (1 - Math.min(part, 1.02));
  }

  axes(brush) {
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    brush.font = "11px system-ui, sans-serif";
    brush.lineWidth = 1;
    const ticks = this.wide ? [1e-4, 1e-3, 1e-2, 0.1, 1, 10, 100, 1000] : [0, 1, 2].map((n) => n * roundStep(this.most / 2));
    for (const tick of ticks.filter((value) => value >= this.least && value <= this.most)) {
      brush.fillStyle = paint("var(--soft)");
      brush.textAlign = "right";
      brush.fillText(metres(tick), this.margin - 6, this.y(tick) + 4);
      brush.fillStyle = paint("var(--line)");
      brush.fillRect(this.margin, this.y(tick), width - this.margin - 8, 1);
    }
    const end = this.recording.times.at(-1) / 1000;
    const step = roundStep(end / Math.max(width / 110, 2));
    brush.fillStyle = paint("var(--soft)");
    brush.textAlign = "center";
    for (let t = 0; t <= end; t += step) brush.fillText(`${+t.toFixed(3)} s`, Math.min(this.x(1000 * t), width - 16), height - 4);
    brush.textAlign = "left";
  }

  line(brush, run) {
    const values = run[this.quantity];
    brush.strokeStyle = paint(run.colour);
    brush.lineWidth = 1.3;
    brush.setLineDash(run.dash);
    brush.beginPath();
    for (let i = 0, pen = false; i < values.length; i++) {
      const there = !Number.isNaN(values[i]);
      if (there) brush[pen ? "lineTo" : "moveTo"](this.x(this.recording.times[i]), this.y(values[i]));
      pen = there;
    }
    brush.stroke();
    brush.setLineDash([]);
  }

  draw(scan) {
    const brush = resized(this.canvas);
    if (this.lines.width) brush.drawImage(this.lines, 0, 0, this.canvas.clientWidth, this.canvas.clientHeight);
    const x = this.x(this.recording.times[scan]);
    brush.fillStyle = paint("var(--ink)");
    brush.fillRect(x - 0.75, 0, 1.5, this.canvas.clientHeight - 16);
  }
}

function roundStep(about) {
  const power = 10 ** Math.floor(Math.log10(Math.max(about, 1e-9)));
  return [1, 2, 5, 10].map((step) => step * power).filter((step) => step <= about * 1.0001).at(-1) ?? power;
}

const metres = (value) => (value >= 1 || value === 0 ? `${+value.toFixed(2)} m` : value >= 0.1 ? `${+(100 * value).toFixed(1)} cm` : `${+(1000 * value).toFixed(1)} mm`);
