// Controls: time, layout, legend, keys. One Player for each element of the class gsb-player.

const STILL_S = 0.5; // of simulated time between pictures, for readers who want no motion

class Player {
  constructor(root) {
    this.root = root;
    this.texts = [...root.querySelectorAll("script.clip")].map((element) => element.textContent);
    this.at = root.querySelector(".at");
    this.picture = new Picture(root);
    this.calm = matchMedia("(prefers-reduced-motion: reduce)");
    root.querySelector(".told").hidden = true;
    root.querySelector(".stage").hidden = false;
    this.listen();
    this.show(0);
  }

  part(name) { return this.root.querySelector(`.${name}`); }

  listen() {
    const jump = (name, to) => this.part(name).addEventListener("click", () => this.jump(to()));
    this.part("play").addEventListener("click", () => this.play(!this.playing));
    jump("back", () => this.step - 1);
    jump("on", () => this.step + 1);
    jump("first", () => this.clip.classes.first);
    jump("before", () => this.split(-1));
    jump("next", () => this.split(1));
    this.at.addEventListener("input", () => this.jump(Number(this.at.value)));
    this.part("clips").addEventListener("change", (event) => this.show(Number(event.target.value)));
    // a page of its own needs no click before its keys work; beside other content they are the player's alone
    (this.root.closest("main.alone") ? document : this.root).addEventListener("keydown", (event) => this.key(event));
  }

  // begin with a clip
  show(index) {
    this.play(false);
    this.clip = new Clip(this.texts[index]);
    const { classes, tracks } = this.clip;
    this.at.max = this.clip.last;
    this.part("first").disabled = !this.clip.compared || classes.first === null;
    this.part("layout").closest("label").hidden = tracks.length < 2;
    this.part("layout").value = this.clip.compared || tracks.length < 2 ? "over" : "beside";
    this.part("view").setAttribute("aria-description", this.clip.title);
    this.part("notes").replaceChildren(...this.clip.notes.map((note) => made("li", note)));
    this.legend();
    this.marks();
    this.picture.show(this.clip);
    this.jump(0);
  }

  legend() {
    this.part("legend").querySelector("legend").textContent = `Shown, by ${this.clip.numbers}`;
    this.entries = this.clip.tracks.map((track, index) => {
      const box = made("input");
      box.type = "checkbox";
      box.checked = true;
      box.addEventListener("change", () => {
        if (box.checked) this.picture.hidden.delete(index);
        else this.picture.hidden.add(index);
        this.picture.paint();
      });
      const chip = made("span", track.short, "chip");
      const label = made("label");
      const about = made("small");
      label.append(made("bdi", track.label), about);
      box.id = label.htmlFor = `gsb-track-${Player.count++}`;
      const row = made("li");
      row.append(box, chip, label);
      return { row, chip, about };
    });
    this.part("legend").querySelector("ul").replaceChildren(...this.entries.map((entry) => entry.row));
  }

  // the number of distinct environments over time, and where it grows
  marks() {
    const { classes, last } = this.clip;
    const x = (step) => (1000 * step) / Math.max(1, last);
    const group = this.part("marks");
    group.replaceChildren();
    let path = "";
    if (this.clip.compared) {
      const most = Math.max(...classes.distinct, 2);
      const y = (count) => 28 - (24 * (count - 1)) / (most - 1);
      path = classes.steps.map((step, i) => `${i ? "H" : "M"}${x(step)} ${i ? `V${y(classes.distinct[i])}` :
        y(classes.distinct[i])}`).join("") + "H1000";
      for (const step of classes.splits) {
        const line = document.createElementNS("http://www.w3.org/2000/svg", "line");
        for (const [name, value] of Object.entries({ x1: x(step), x2: x(step), y1: 0, y2: 30 }))
          line.setAttribute(name, value);
        if (step === classes.first) line.setAttribute("class", "onset");
        group.append(line);
      }
    }
    this.part("count").setAttribute("d", path);
  }

  split(direction) {
    const splits = this.clip.compared ? this.clip.classes.splits : [];
    const found = direction > 0 ? splits.find((step) => step > this.step) :
      splits.findLast((step) => step < this.step);
    return found;
  }

  // to a step, by the reader's hand
  jump(step) {
    if (step === undefined || step === null) return;
    this.play(false);
    this.go(step);
    this.part("loud").textContent = `${this.part("distinct").textContent}, ${this.part("moment").textContent}`;
  }

  go(step) {
    this.step = Math.min(this.clip.last, Math.max(0, step));
    this.at.value = this.step;
    this.tell();
    this.picture.at(this.step);
  }

  play(on) {
    if (on === Boolean(this.playing)) return;
    this.playing = on;
    this.part("play").textContent = on ? "Pause" : "Play";
    if (!on) return;
    if (this.step >= this.clip.last) this.go(0);
    let exact = this.step * this.clip.dt, before;
    const tick = (now) => {
      if (!this.playing) return;
      const passed = before === undefined ? 0 : (Math.min(now - before, 250) / 1000) * Number(this.part("speed").value);
      before = now;
      exact += passed;
      const shown = this.calm.matches ? Math.floor(exact / STILL_S) * STILL_S : exact;
      const step = Math.floor(shown / this.clip.dt + 1e-6);
      if (step > this.step) this.go(step);
      if (exact >= this.clip.last * this.clip.dt) {
        this.go(this.clip.last);
        this.play(false);
      } else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  // the moment in words, in the status, the slider and the legend
  tell() {
    const { clip, step } = this;
    const { classes, tracks } = clip;
    let words = `bits are not compared: ${classes.reason}`;
    if (clip.compared) {
      const change = clip.change(step);
      const [distinct, instant] = [classes.distinct[change], classes.instant[change]];
      if (classes.n < 2) words = "one environment, nothing to compare it with";
      else if (distinct === 1) words = `all ${classes.n} ${clip.whose} bit-identical so far`;
      else words = `${distinct} distinct of ${classes.n} ${clip.whose} so far` +
        (instant < distinct ? `, ${instant} at this step alone` : "");
    }
    const time = `step ${step} of ${clip.last}, ${fixed(step * clip.dt)} s`;
    const rows = tracks.map((track) => track.steps[clip.row(track, step)]);
    const old = [...new Set(rows.filter((row) => row !== step))];
    this.part("distinct").textContent = words;
    this.part("moment").textContent = old.length ? `${time}; drawn: the state of step ${old.join(" and ")}` : time;
    this.at.setAttribute("aria-valuetext", `${time}, ${words}`);
    this.part("before").disabled = this.split(-1) === undefined;
    this.part("next").disabled = this.split(1) === undefined;
    this.tellEach(clip.leaders(step));
  }

  tellEach(leaders) {
    const { clip, step } = this;
    this.entries.forEach(({ chip, about }, index) => {
      const track = clip.tracks[index];
      const leader = leaders[index];
      const told = [];
      if (clip.compared) {
        const size = clip.classes.size[clip.change(step)][index];
        told.push(leader !== index ? `same bits as ${clip.tracks[leader].label} so far` :
          `${size} of ${clip.classes.n} with these bits so far`);
      }
      const row = clip.row(track, step);
      const apart = track.apart[row];
      if (index > 0 && leader !== 0 && apart !== null)
        told.push(`${length(apart)} from ${clip.tracks[0].label} at most (${track.items[track.furthest[row]].name})`);
      chip.className = `chip k${leader % 8}`;
      chip.textContent = clip.tracks[leader].short;
      about.textContent = told.join("; ");
    });
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const busy = event.target.closest("button, select, input[type=checkbox], summary");
    const actions = {
      " ": () => this.play(!this.playing),
      ",": () => this.jump(this.step - 1),
      ".": () => this.jump(this.step + 1),
      f: () => this.clip.compared && this.jump(this.clip.classes.first),
      n: () => this.jump(this.split(1)),
      p: () => this.jump(this.split(-1)),
      Home: () => this.jump(0),
      End: () => this.jump(this.clip.last),
    };
    const action = actions[event.key];
    const theirs = busy && (event.key === " " || busy.tagName === "SELECT" || event.key.length > 1);
    if (!action || theirs) return;
    event.preventDefault();
    action();
  }
}

Player.count = 0;

function made(name, text, kind) {
  const element = document.createElement(name);
  if (text !== undefined) element.textContent = text;
  if (kind) element.className = kind;
  return element;
}

const fixed = (seconds) => String(Number(seconds.toPrecision(6)));

// a distance [m] in a unit that fits
function length(metres) {
  for (const [unit, size] of [["m", 1], ["cm", 1e-2], ["mm", 1e-3], ["µm", 1e-6], ["nm", 1e-9]])
    if (metres >= size) return `${Number((metres / size).toPrecision(3))} ${unit}`;
  return metres > 0 ? `${metres.toPrecision(2)} m` : "0 m";
}

for (const root of document.querySelectorAll(".gsb-player")) new Player(root);
