// The scan-by-scan player of each sequence: its controls, its keys, and the view of the current scan.
class Player {
  constructor(root) {
    this.root = root;
    this.ready = false;
    this.worst = [];
    this.timer = 0;
    this.wanted = new Map(); // choices of the reader that a filter hides at the moment, by select
    this.find = (selector) => root.querySelector(selector);
    this.all = (selector) => [...root.querySelectorAll(selector)];
  }

  async start() {
    this.recording = await readRecording(this.find("template").content.textContent);
    this.state = { scan: 0 };
    const canvas = this.find("canvas.map");
    this.view = new View(canvas, () => this.draw());
    this.stage = new Stage(canvas, this.recording, await this.pictures());
    this.traces = this.all("canvas.trace").map((own) => new Trace(own, this.recording, own.dataset.quantity, (at) => this.seek(at)));
    this.find("input[type=range]").max = this.recording.count - 1;
    this.listen();
    this.ready = true;
    this.root.classList.add("ready");
    this.choose();
    this.home();
    this.go(this.worst[0]?.scan ?? 0);
    this.first = playerState(this);
    this.kept = JSON.stringify(this.first);
    new ResizeObserver(() => this.resize()).observe(canvas);
  }

  // The images of the maps, further down the page.
  async pictures() {
    const figures = [...document.querySelectorAll(`#${this.root.dataset.anchor} .maps figure`)];
    const loaded = await Promise.all(figures.map(async (figure) => {
      const image = new Image();
      image.src = figure.querySelector("img").src;
      await image.decode().catch(() => undefined);
      return [figure.dataset.of ?? "", image];
    }));
    return new Map(loaded);
  }

  listen() {
    const does = {
      play: () => this.toggle(),
      first: () => this.go(0),
      back: () => this.go(this.state.scan - 1),
      on: () => this.go(this.state.scan + 1),
      last: () => this.go(this.recording.count - 1),
      in: () => this.view.zoom(1.5, ...this.spot()),
      out: () => this.view.zoom(1 / 1.5, ...this.spot()),
      home: () => this.home(),
      copy: () => this.copy(),
    };
    for (const button of this.all("button[data-does]")) button.addEventListener("click", does[button.dataset.does]);
    this.find("input[type=range]").addEventListener("input", (event) => this.go(Number(event.target.value)));
    this.root.addEventListener("change", (event) => {
      this.wanted.delete(event.target);
      this.choose();
      if (event.target.dataset.picks === "correction" && this.state.correction) this.seek(this.state.correction.at);
    });
    document.addEventListener("theme", () => this.resize());
    this.find(".stage").addEventListener("keydown", (event) => this.key(event, does));
    document.addEventListener("methods", () => this.choose());
    for (const kind of ["change", "input", "click", "keyup", "pointerup", "wheel"]) {
      this.root.addEventListener(kind, () => this.rememberSoon(), { passive: true });
    }
  }

  // Browsers limit how often a page may change its address.
  rememberSoon() {
    clearTimeout(this.soon);
    this.soon = setTimeout(() => this.remember(), 250);
  }

  remember() {
    const now = playerState(this);
    if (this.timer || JSON.stringify(now) === this.kept) return;
    this.kept = JSON.stringify(now);
    link.write(different(now, this.first), this.place);
  }

  get place() { return `${this.root.dataset.anchor}-player`; }

  async copy() {
    this.stop();
    link.write(different(playerState(this), this.first), this.place);
    const status = this.find(".copied");
    const done = navigator.clipboard?.writeText(location.href) ?? Promise.reject(new Error("no clipboard"));
    status.textContent = await done.then(() => "copied", () => "see the address bar");
    setTimeout(() => { status.textContent = ""; }, 4000);
  }

  key(event, does) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "BUTTON" && event.key === " ") return;
    const far = event.shiftKey ? 10 : 1;
    const keys = {
      " ": does.play, "+": does.in, "=": does.in, "-": does.out, "0": does.home, Home: does.first, End: does.last,
      ArrowLeft: () => this.go(this.state.scan - far), ArrowRight: () => this.go(this.state.scan + far),
      ArrowUp: () => this.view.pan(0, 40), ArrowDown: () => this.view.pan(0, -40),
    };
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  }

  // Reads the controls: methods, map, method that places the scan, layers.
  choose() {
    if (!this.ready) return;
    this.offer();
    const ticked = new Set(this.all("input.shows").filter((box) => box.checked && isShown(box.value)).map((box) => box.value));
    const layers = Object.fromEntries(this.all("input[data-layer]").map((box) => [box.dataset.layer, box.checked]));
    const picked = Object.fromEntries(this.all("select[data-picks]").map((select) => [select.dataset.picks, select.value]));
    const placer = picked.first === "truth" ? "" : picked.first;
    const own = { own: this.recording.runs.find((run) => run.label === placer)?.map ?? placer, true: "" }[picked.map] ?? this.find("select[data-picks=map]").selectedOptions[0].dataset.map;
    const runs = this.recording.runs.filter((run) => ticked.has(run.label));
    Object.assign(this.state, { layers, runs, map: own, first: picked.first, second: picked.second, quantity: picked.quantity });
    this.correct(picked);
    const names = JSON.stringify([...runs.map((run) => run.label), ...this.all(".worst select").map((select) => select.value)]);
    if (names !== this.names) {
      for (const trace of this.traces) trace.prepare(runs);
      this.rank();
    }
    this.names = names;
    this.draw();
  }

  // The correction that is shown, and what it moved in words.
  correct(picked) {
    this.state.correction = this.recording.corrections.find((one) => one.name === picked.correction);
    this.state.side = picked.side;
    const words = this.find(".correction");
    if (words) words.textContent = this.state.correction?.words ?? "";
  }

  // A filtered method neither places a scan nor is compared or drawn.
  offer() {
    for (const option of this.all("option[data-map]")) {
      option.hidden = !isShown(option.dataset.map);
      if (option.hidden && option.selected) option.parentElement.value = "own";
    }
    for (const option of this.all("option[data-run]")) {
      option.hidden = !isShown(option.dataset.run);
      if (option.hidden && option.selected) option.closest("select").value = "";
    }
    for (const select of this.all("select[data-picks=first], select[data-picks=second], select[data-worst=a], select[data-worst=b]")) {
      const named = [...select.options].filter((option) => this.recording.runs.some((run) => run.label === option.value));
      for (const option of named) option.hidden = !isShown(option.value);
      const left = named.filter((option) => !option.hidden);
      const own = this.wanted.get(select);
      if (own && isShown(own)) { // the choice that a filter had replaced
        select.value = own;
        this.wanted.delete(select);
      }
      if (!select.selectedOptions[0]?.hidden || !left.length) continue;
      this.wanted.set(select, own ?? select.value);
      select.value = left[0].value;
    }
    const [a, b] = ["a", "b"].map((side) => this.find(`select[data-worst=${side}]`));
    const other = [...b?.options ?? []].find((option) => !option.hidden && option.value !== a.value);
    if (!other || a.value !== b.value) return;
    this.wanted.set(b, this.wanted.get(b) ?? b.value);
    b.value = other.value;
  }

  resize() {
    if (!this.view.touched && this.canHome()) this.home();
    for (const trace of this.traces) trace.prepare(this.state.runs);
    this.draw();
  }

  canHome() { return this.view.size[0] > 0; }

  home() {
    const { window: shown, truth, runs } = this.recording;
    if (shown) {
      this.view.fit(...shown);
      return;
    }
    const path = (truth ?? runs[0]).poses;
    const of = (axis) => path.filter((value, i) => i % 3 === axis && !Number.isNaN(value));
    const [xs, ys] = [[0, ...of(0)], [0, ...of(1)]]; // with the world's origin, if no method has a pose
    this.view.fit(Math.min(...xs) - 1, Math.max(...xs) + 1, Math.min(...ys) - 1, Math.max(...ys) + 1);
  }

  // The position of the robot on the canvas, if visible: keys and buttons zoom there.
  spot() {
    const { truth, runs } = this.recording;
    const { poses } = this.state.first === "truth" ? truth : runs.find((run) => run.label === this.state.first);
    const at = this.view.toScreen(poses[3 * this.state.scan], poses[3 * this.state.scan + 1]);
    return at.every((value, axis) => value >= 0 && value <= this.view.size[axis]) ? at : [];
  }

  seek(milliseconds) {
    const { times } = this.recording;
    const nearest = times.reduce((best, time, i) => (Math.abs(time - milliseconds) < Math.abs(times[best] - milliseconds) ? i : best), 0);
    this.go(nearest);
  }

  go(scan) {
    this.state.scan = Math.min(Math.max(scan, 0), this.recording.count - 1);
    this.draw();
  }

  toggle() {
    if (this.timer) {
      this.stop();
      return;
    }
    if (this.state.scan === this.recording.count - 1) this.go(0);
    const { times } = this.recording;
    let clock = times[this.state.scan];
    let last = performance.now();
    const tick = (now) => {
      // with reduced motion: single steps, at most four per second
      const calm = matchMedia("(prefers-reduced-motion: reduce)").matches && now - last < 250;
      if (!calm) {
        clock += (now - last) * Number(this.find("select.speed").value);
        last = now;
        let scan = this.state.scan;
        while (scan < this.recording.count - 1 && times[scan + 1] <= clock) scan += 1;
        if (scan !== this.state.scan) this.go(scan);
        if (scan === this.recording.count - 1) {
          this.stop();
          return;
        }
      }
      this.timer = requestAnimationFrame(tick);
    };
    this.timer = requestAnimationFrame(tick);
    this.playing(true);
  }

  stop() {
    cancelAnimationFrame(this.timer);
    this.timer = 0;
    this.playing(false);
    this.rememberSoon();
  }

  playing(now) {
    const button = this.find("button[data-does=play]");
    button.textContent = now ? "❚❚" : "▶";
    button.setAttribute("aria-label", now ? "Pause" : "Play");
  }

  rank() {
    const [a, b] = ["a", "b"].map((side) => this.recording.runs.find((run) => run.label === this.find(`select[data-worst=${side}]`)?.value));
    const list = this.find(".worst ol");
    if (!a || !b) return;
    const by = this.find("select[data-worst=by]").value;
    const found = this.worst = a === b ? [] : worstScans(this.recording, a, b, by);
    list.replaceChildren(...found.map(({ scan, value }) => {
      const [item, button] = [document.createElement("li"), document.createElement("button")];
      const what = { apart: "apart", error: "more error", step: "apart in one step" }[by];
      button.type = "button";
      button.textContent = `scan ${this.recording.numbers[scan]}, ${this.seconds(scan)}: ${metres(value)} ${what}`;
      button.addEventListener("click", () => this.compare(a, b, scan));
      item.append(button);
      return item;
    }));
    this.find(".worst .nothing").hidden = found.length > 0;
  }

  // Both placements of one scan, zoomed in until they are distinguishable.
  compare(a, b, scan) {
    this.find("select[data-picks=first]").value = a.label;
    this.find("select[data-picks=second]").value = b.label;
    this.choose();
    if (this.view.touched) Object.assign(this.view, { x: a.poses[3 * scan], y: a.poses[3 * scan + 1] });
    this.go(scan);
    this.find(".stage").focus({ preventScroll: true });
    this.root.scrollIntoView({ block: "start" });
  }

  seconds(scan) { return `${(this.recording.times[scan] / 1000).toFixed(2)} s`; }

  draw() {
    if (!this.ready || !this.canHome()) return;
    const { scan } = this.state;
    this.stage.draw(this.view, this.state);
    for (const trace of this.traces) trace.draw(scan);
    const position = `scan ${this.recording.numbers[scan]} of ${this.recording.of}, ${this.seconds(scan)}`;
    const slider = this.find("input[type=range]");
    slider.value = scan;
    slider.setAttribute("aria-valuetext", position);
    this.find(".at").textContent = position;
    for (const cell of this.all("td[data-quantity]")) {
      const run = this.recording.runs.find((one) => one.label === cell.dataset.run);
      const value = run?.[cell.dataset.quantity]?.[scan];
      cell.textContent = value === undefined || Number.isNaN(value) ? "–" : (1000 * value).toFixed(1);
    }
  }
}

// If the browser cannot unpack the recording, only the figures above are shown.
if (window.DecompressionStream && window.OffscreenCanvas) {
  const started = (root) => {
    root.player ??= new Player(root);
    root.started ??= root.player.start();
    return root.started;
  };
  const near = new IntersectionObserver((seen) => {
    for (const { target, isIntersecting } of seen) {
      if (!isIntersecting) continue;
      near.unobserve(target);
      started(target);
    }
  }, { rootMargin: "800px" });
  document.addEventListener("built", ({ detail }) => {
    for (const root of detail.querySelectorAll(".player[hidden]")) {
      root.hidden = false;
      near.observe(root);
    }
  });
  document.addEventListener("linked", async () => {
    const root = document.getElementById(link.place)?.nextElementSibling;
    if (!root?.matches(".player")) return;
    const words = new Map(link.words);
    link.words.delete("play");
    await started(root);
    restore(root.player, words);
    if (words.has("play") && !root.player.timer) root.player.toggle();
  });
}
