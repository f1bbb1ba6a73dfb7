// The visible part of the world and its controls: drag, wheel, pinch, keys, buttons, the URL fragment.
//
// x is east and z is south, in metres. The level is a real number: at level k a CSS pixel covers 0.5 * 2^k metres, as a pixel of a
// tile of level k does.

const MIN_LEVEL = -3;
const KEY_STEP_PX = 90;
const ZOOM_STEP = 0.75;
// Levels per unit of wheel movement; a notch of a mouse wheel is about 100 units.
const WHEEL = 1 / 240;
const GLIDE_MS = 220;

export class View {
  #listeners = [];
  #glide = null;
  #pointers = new Map();
  #written = 0;

  constructor(element, world) {
    this.element = element;
    this.half = world.world_half_m;
    this.maxLevel = world.levels - 2;
    this.calm = matchMedia('(prefers-reduced-motion: reduce)');
    this.x = 0;
    this.z = 0;
    this.level = 6;
    this.#measure();
    new ResizeObserver(() => { this.#measure(); this.#changed(); }).observe(element);
    this.#listen();
    if (!this.#readAddress()) this.home(false);
  }

  onChange(listener) { this.#listeners.push(listener); }

  get metresPerPixel() { return 0.5 * 2 ** this.level; }

  toScreen(x, z) {
    const scale = 1 / this.metresPerPixel;
    return [(x - this.x) * scale + this.width / 2, (z - this.z) * scale + this.height / 2];
  }

  toWorld(px, py) {
    const scale = this.metresPerPixel;
    return [this.x + (px - this.width / 2) * scale, this.z + (py - this.height / 2) * scale];
  }

  // The home island and some sea around it, in the area without cards.
  home(glides = true) {
    const free = Math.min(this.width > 640 ? this.width - 350 : this.width, this.height > 500 ? this.height - 60 : this.height);
    const level = Math.log2(13500 / Math.max(free, 100) / 0.5);
    const shift = this.width > 900 ? 160 * 0.5 * 2 ** level : 0;
    this.goTo({ x: shift, z: 0, level }, glides);
  }

  goTo(target, glides = true) {
    const to = this.#bounded({ x: this.x, z: this.z, level: this.level, ...target });
    cancelAnimationFrame(this.#glide);
    if (!glides || this.calm.matches) {
      this.#set(to);
      return;
    }
    const from = { x: this.x, z: this.z, level: this.level };
    const start = performance.now();
    const step = (now) => {
      const share = Math.min(1, Math.max(0, now - start) / GLIDE_MS);
      const eased = 1 - (1 - share) ** 3;
      const mix = (name) => from[name] + (to[name] - from[name]) * eased;
      this.#set({ x: mix('x'), z: mix('z'), level: mix('level') });
      if (share < 1) this.#glide = requestAnimationFrame(step);
    };
    this.#glide = requestAnimationFrame(step);
  }

  panBy(px, py, glides = false) {
    const scale = this.metresPerPixel;
    this.goTo({ x: this.x + px * scale, z: this.z + py * scale }, glides);
  }

  // Zooms around a point of the screen.
  zoomAt(px, py, levels, glides = false) {
    const level = Math.min(this.maxLevel, Math.max(MIN_LEVEL, this.level + levels));
    const [x, z] = this.toWorld(px, py);
    const shrink = 2 ** (level - this.level);
    this.goTo({ x: x + (this.x - x) * shrink, z: z + (this.z - z) * shrink, level }, glides);
  }

  zoomBy(levels) { this.zoomAt(this.width / 2, this.height / 2, levels, true); }

  #measure() {
    this.width = this.element.clientWidth;
    this.height = this.element.clientHeight;
  }

  #bounded({ x, z, level }) {
    const inside = (value) => Math.min(this.half, Math.max(-this.half, value));
    return { x: inside(x), z: inside(z), level: Math.min(this.maxLevel, Math.max(MIN_LEVEL, level)) };
  }

  #set({ x, z, level }) {
    Object.assign(this, { x, z, level });
    this.#changed();
  }

  #changed() {
    for (const listener of this.#listeners) listener();
    clearTimeout(this.#written);
    this.#written = setTimeout(() => this.#writeAddress(), 250);
  }

  #writeAddress() {
    const place = `#x=${Math.round(this.x)}&z=${Math.round(this.z)}&level=${this.level.toFixed(2)}`;
    if (location.hash !== place) history.replaceState(null, '', place);
  }

  #readAddress() {
    const parts = new URLSearchParams(location.hash.slice(1));
    const [x, z, level] = ['x', 'z', 'level'].map((name) => Number.parseFloat(parts.get(name)));
    if (![x, z, level].every(Number.isFinite)) return false;
    this.goTo({ x, z, level }, false);
    return true;
  }

  #listen() {
    const map = this.element;
    map.addEventListener('pointerdown', (event) => {
      if (event.button !== 0) return;
      map.setPointerCapture(event.pointerId);
      this.#pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    });
    map.addEventListener('pointermove', (event) => this.#drag(event));
    for (const name of ['pointerup', 'pointercancel', 'lostpointercapture']) {
      map.addEventListener(name, (event) => this.#pointers.delete(event.pointerId));
    }
    map.addEventListener('wheel', (event) => {
      event.preventDefault();
      // Approximate units of lines and pages, which some browsers report.
      const units = event.deltaY * [1, 33, 400][event.deltaMode];
      const levels = Math.max(-1, Math.min(1, units * WHEEL * (event.ctrlKey ? 4 : 1)));
      this.zoomAt(event.offsetX, event.offsetY, levels);
    }, { passive: false });
    map.addEventListener('dblclick', (event) => this.zoomAt(event.offsetX, event.offsetY, -1, true));
    map.addEventListener('keydown', (event) => this.#key(event));
    addEventListener('hashchange', () => this.#readAddress());
  }

  #drag(event) {
    const before = this.#pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.offsetX, event.offsetY];
    const other = [...this.#pointers].find(([id]) => id !== event.pointerId)?.[1];
    this.#pointers.set(event.pointerId, now);
    if (!other) {
      this.panBy(before[0] - now[0], before[1] - now[1]);
      return;
    }
    // Two fingers: their centre drags, their distance zooms.
    const apart = (point) => Math.max(1, Math.hypot(point[0] - other[0], point[1] - other[1]));
    this.panBy((before[0] - now[0]) / 2, (before[1] - now[1]) / 2);
    this.zoomAt((now[0] + other[0]) / 2, (now[1] + other[1]) / 2, Math.log2(apart(before) / apart(now)));
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = KEY_STEP_PX * (event.shiftKey ? 4 : 1);
    const actions = {
      ArrowLeft: () => this.panBy(-step, 0, true),
      ArrowRight: () => this.panBy(step, 0, true),
      ArrowUp: () => this.panBy(0, -step, true),
      ArrowDown: () => this.panBy(0, step, true),
      '+': () => this.zoomBy(-ZOOM_STEP),
      '=': () => this.zoomBy(-ZOOM_STEP),
      '-': () => this.zoomBy(ZOOM_STEP),
      _: () => this.zoomBy(ZOOM_STEP),
      0: () => this.home(),
      Home: () => this.home(),
    };
    const action = actions[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }
}
