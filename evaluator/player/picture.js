// The picture: cameras and canvases, what is drawn where, and what the pointer is on.

const TURN = 0.12; // by one key [rad]
const NESTED = 0.7; // size of a body within another one's in the same place

// whether two bodies would hide each other
const near = (a, b, shape) => Math.hypot(...minus(a.at, b.at)) < 0.1 * Math.min(...shape.size);

class Picture {
  constructor(root) {
    this.root = root;
    this.canvas = this.part("view");
    this.context = this.canvas.getContext("2d");
    this.drawn = [];
    this.hidden = new Set(); // tracks that the reader does not want to see
    this.listenToPointer();
    this.canvas.addEventListener("keydown", (event) => this.turnByKey(event));
    this.part("layout").addEventListener("change", () => { this.fit(); this.paint(); });
    this.part("reset").addEventListener("click", () => this.reset());
    new ResizeObserver(() => this.paint()).observe(this.canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.paint());
  }

  part(name) { return this.root.querySelector(`.${name}`); }

  // begin with a clip; its first picture is asked for by `at`
  show(clip) {
    this.clip = clip;
    this.hidden.clear();
    this.fit();
  }

  // show a step
  at(step) {
    this.step = step;
    this.paint();
  }

  listenToPointer() {
    let last;
    this.canvas.addEventListener("pointerdown", (event) => {
      last = [event.clientX, event.clientY];
      this.canvas.setPointerCapture(event.pointerId);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (!last) return this.point(event);
      this.camera.turn((last[0] - event.clientX) * 0.008, (event.clientY - last[1]) * 0.008);
      last = [event.clientX, event.clientY];
      this.paint();
    });
    for (const end of ["pointerup", "pointercancel"]) this.canvas.addEventListener(end, () => (last = undefined));
    this.canvas.addEventListener("pointerleave", () => (this.part("pointed").hidden = true));
    this.canvas.addEventListener("wheel", (event) => {
      if (document.activeElement !== this.canvas) return; // the page is scrolled past it
      event.preventDefault();
      this.camera.zoom(Math.exp(event.deltaY * 0.001));
      this.paint();
    }, { passive: false });
  }

  turnByKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const actions = {
      ArrowLeft: () => this.camera.turn(-TURN, 0),
      ArrowRight: () => this.camera.turn(TURN, 0),
      ArrowUp: () => this.camera.turn(0, TURN),
      ArrowDown: () => this.camera.turn(0, -TURN),
      "+": () => this.camera.zoom(0.85),
      "=": () => this.camera.zoom(0.85),
      "-": () => this.camera.zoom(1 / 0.85),
      0: () => this.reset(),
    };
    if (!actions[event.key]) return;
    event.preventDefault();
    actions[event.key]();
    this.paint();
  }

  // places of the environments, and a camera that sees them all
  fit() {
    const { low, high, tracks } = this.clip;
    const size = minus(high, low);
    const beside = this.part("layout").value === "beside";
    const columns = beside ? Math.ceil(Math.sqrt(tracks.length)) : 1;
    const rows = beside ? Math.ceil(tracks.length / columns) : 1;
    const apart = [1.25 * size[0] + 0.05, 1.25 * size[1] + 0.05];
    this.places = tracks.map((_, index) => beside ?
      [(index % columns) * apart[0], -Math.floor(index / columns) * apart[1], 0] : [0, 0, 0]);
    this.camera = new Camera(
      minus(low, [0, (rows - 1) * apart[1], 0]), plus(high, [(columns - 1) * apart[0], 0, 0]));
  }

  reset() {
    this.camera.reset();
    this.paint();
  }

  paint() {
    if (this.waiting || !this.clip) return;
    this.waiting = requestAnimationFrame(() => {
      this.waiting = undefined;
      this.draw();
    });
  }

  draw() {
    const { canvas, context, camera, clip } = this;
    const density = Math.min(devicePixelRatio || 1, 3);
    const [width, height] = [Math.round(canvas.clientWidth * density), Math.round(canvas.clientHeight * density)];
    if (!width || !height) return;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const style = getComputedStyle(this.root);
    const colour = (name) => style.getPropertyValue(name).trim();
    const theme = { ink: colour("--ink"), still: colour("--gsb-still"), rule: colour("--quiet"), page: colour("--page") };
    camera.look(width, height);
    camera.pixel = density;
    context.globalAlpha = 1;
    context.clearRect(0, 0, width, height);
    const leaders = clip.leaders(this.step);
    const beside = this.part("layout").value === "beside";
    // in one place, bit-identical environments are drawn once, by the first of them that is not hidden
    const there = clip.tracks.map((_, index) => index).filter((index) => !this.hidden.has(index));
    const shown = beside ? there :
      there.filter((index) => there.find((other) => leaders[other] === leaders[index]) === index);
    const clusters = beside ? shown.map((index) => [index]) : [shown];
    clusters.sort((a, b) => this.far(b[0]) - this.far(a[0]));
    this.drawn = [];
    for (const cluster of clusters) this.drawCluster(cluster, leaders, theme, colour, density);
    if (!beside && shown.length > 1) this.tags(shown, leaders, theme, colour, density);
    this.tellOutside(shown);
    if (beside) this.names(shown, leaders, theme, colour, density);
  }

  far(index) { return index === undefined ? 0 : this.camera.depth(plus(this.places[index], this.clip.low)); }

  drawCluster(cluster, leaders, theme, colour, density) {
    const { camera, clip, context } = this;
    const place = this.places[cluster[0] ?? 0];
    const identity = { at: [0, 0, 0], turn: [1, 0, 0, 0, 1, 0, 0, 0, 1] };
    const still = { colour: theme.still, ink: theme.rule, alpha: 1, dash: [], width: density };
    const fixed = clip.fixed.map((shape) => new Solid(shape, identity, place, still));
    for (const ground of clip.ground) grid(context, ground, place, camera, theme.rule);
    const before = []; // poses of the tracks that were taken already
    const moving = cluster.flatMap((index) => {
      const track = clip.tracks[index];
      const row = clip.row(track, this.step);
      const look = {
        colour: colour(`--g${leaders[index] % 8}`), ink: theme.ink, width: density, track: index,
        alpha: index === cluster[0] ? 1 : 0.85,
        dash: DASHES[leaders[index] % 8].map((part) => part * density),
      };
      const poses = track.items.map((_, number) => clip.pose(track, row, number));
      const solids = track.items.flatMap((item, number) => {
        const pose = poses[number];
        if (!pose) return [];
        const { shapes } = item;
        const together = shapes.length &&
          before.filter((others) => others[number] && near(others[number], pose, shapes[0])).length;
        const more = { ...look, name: item.name, item: number, shrink: NESTED ** together };
        if (together) more.alpha = 1;
        return shapes.map((shape) => new Solid(shape, pose, place, more));
      });
      before.push(poses);
      return solids;
    });
    for (const solid of ordered(fixed, moving, camera)) {
      draw(context, solid, camera);
      const middle = solid.track === undefined ? undefined : camera.project(solid.at);
      if (middle) this.drawn.push({ solid, x: middle[0], y: middle[1], reach: Math.max(5, middle[2] * solid.reach) });
    }
  }

  // says what is not in the picture: cubes that fell through a board are soon far below it
  tellOutside(shown) {
    const { canvas } = this;
    const inside = new Set(this.drawn.filter((one) => one.x >= 0 && one.y >= 0 && one.x <= canvas.width &&
      one.y <= canvas.height).map((one) => `${one.solid.track} ${one.solid.item}`));
    const told = shown.flatMap((index) => {
      const { items, label } = this.clip.tracks[index];
      const missing = items.filter(({ shapes }, item) => shapes.length && !inside.has(`${index} ${item}`));
      const names = missing.length > 2 ? `${missing.length} of ${items.length} bodies` :
        missing.map((item) => item.name).join(" and ");
      return missing.length ? [`${names} of ${label}`] : [];
    });
    this.part("outside").textContent = told.length ? `Outside the picture: ${told.join("; ")}.` : "";
  }

  // numbers at the item that the drawn environments have in the most different places of the picture
  tags(shown, leaders, theme, colour, density) {
    const { clip, camera, canvas } = this;
    let widest = { spread: 4 * density };
    const rows = shown.map((index) => clip.row(clip.tracks[index], this.step));
    for (let item = 0; shown.every((index) => item < clip.tracks[index].items.length); item++) {
      const pixels = shown.map((index, turn) => {
        const pose = clip.pose(clip.tracks[index], rows[turn], item);
        return pose && camera.project(pose.at);
      });
      if (pixels.some((p) => !p || p[0] < 0 || p[1] < 60 * density || p[0] > canvas.width || p[1] > canvas.height)) continue;
      const spread = Math.max(...pixels.map((p) => Math.hypot(p[0] - pixels[0][0], p[1] - pixels[0][1])));
      if (spread > widest.spread) widest = { spread, pixels };
    }
    widest.pixels?.forEach((pixel, turn) =>
      this.tag(clip.tracks[shown[turn]].short, pixel, [18 + 10 * turn, -24 - 20 * turn], leaders[shown[turn]],
        theme, colour, density));
  }

  names(shown, leaders, theme, colour, density) {
    const { low, high } = this.clip;
    for (const index of shown) {
      const edge = plus(this.places[index], [(low[0] + high[0]) / 2, low[1], low[2]]);
      const pixel = this.camera.project(edge);
      if (pixel) this.tag(this.clip.tracks[index].short, pixel, [0, 18], leaders[index], theme, colour, density);
    }
  }

  tag(text, [x, y], [right, down], leader, theme, colour, density) {
    const { context } = this;
    const [tx, ty] = [x + right * density, y + down * density];
    context.globalAlpha = 1;
    context.setLineDash([]);
    context.font = `600 ${13 * density}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    const half = context.measureText(text).width / 2 + 5 * density;
    context.strokeStyle = theme.ink;
    context.lineWidth = density;
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(tx, ty);
    context.stroke();
    context.fillStyle = colour(`--g${leader % 8}`);
    context.fillRect(tx - half, ty - 9 * density, 2 * half, 18 * density);
    context.strokeRect(tx - half, ty - 9 * density, 2 * half, 18 * density);
    context.fillStyle = theme.page;
    context.fillText(text, tx, ty);
  }

  // says what is under the pointer
  point(event) {
    const bounds = this.canvas.getBoundingClientRect();
    const ratio = this.canvas.width / this.canvas.clientWidth;
    const [x, y] = [(event.clientX - bounds.left) * ratio, (event.clientY - bounds.top) * ratio];
    const hit = this.drawn.findLast((one) => Math.hypot(one.x - x, one.y - y) <= one.reach);
    const told = this.part("pointed");
    told.hidden = !hit;
    if (!hit) return;
    const { solid } = hit;
    const at = minus(solid.at, this.places[solid.track]).map((metres) => metres.toFixed(3));
    told.textContent = `${this.clip.tracks[solid.track].label}: ${solid.name} at x ${at[0]}, y ${at[1]}, z ${at[2]} m`;
  }
}
