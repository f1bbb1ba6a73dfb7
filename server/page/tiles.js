// Map tiles: requests visible tiles, nearest to the centre first, caches recent ones, and draws coarser or finer ones in place of
// missing ones.

// A decoded tile takes 256 KiB; the cache takes 64 MiB.
const KEPT = 256;
// Browsers open six connections per HTTP/1.1 server; one is left for other requests.
const AT_ONCE = 5;
// Number of coarser levels searched for a replacement.
const ANCESTORS = 8;
const MAX_WAIT_MS = 8000;

export class Tiles {
  #kept = new Map();
  #loading = new Map();
  #failed = new Map();
  #frame = 0;

  constructor(canvas, view, world, request) {
    Object.assign(this, { canvas, view, world, request });
    this.context = canvas.getContext('2d', { alpha: false });
    this.pixels = world.map_tile_pixels;
    // The single tile of the top level begins at the border of the world; it is not used.
    this.topLevel = world.levels - 2;
    view.onChange(() => this.update());
    this.update();
  }

  // Draws in the next frame; repeated calls are merged.
  update() {
    this.#frame ||= requestAnimationFrame(() => {
      this.#frame = 0;
      this.#draw();
    });
  }

  // Retries failed tiles at once, after an outage.
  retry() {
    this.#failed.clear();
    this.update();
  }

  #draw() {
    const { view, canvas, context } = this;
    const ratio = devicePixelRatio || 1;
    const [width, height] = [Math.round(view.width * ratio), Math.round(view.height * ratio)];
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    // The resolution of the screen, or slightly less where that saves three of four tiles.
    const level = Math.min(this.topLevel, Math.max(0, Math.floor(view.level - Math.log2(ratio) + 0.35)));
    const wanted = this.#visible(level);
    context.fillStyle = getComputedStyle(canvas).getPropertyValue('--ground').trim() || '#264e7a';
    context.fillRect(0, 0, width, height);
    context.imageSmoothingQuality = 'high';
    let drawn = 0;
    for (const tile of wanted) {
      const [left, top, right, bottom] = this.#box(tile, ratio);
      const image = this.#image(tile.key);
      if (image) {
        context.drawImage(image, left, top, right - left, bottom - top);
        drawn += 1;
      } else {
        this.#drawAncestor(tile, left, top, right - left, bottom - top);
        this.#drawChildren(tile, ratio);
      }
    }
    this.#load(wanted.filter((tile) => !this.#kept.has(tile.key)));
    Object.assign(canvas.dataset, { level, wanted: wanted.length, drawn });
  }

  // The visible tiles of a level, nearest to the centre first.
  #visible(level) {
    const { view } = this;
    const side = this.world.level_0_side_m * 2 ** level;
    const count = 2 ** (this.world.levels - 1 - level);
    const bounded = (index) => Math.min(count / 2 - 1, Math.max(-count / 2, index));
    const [west, north] = view.toWorld(0, 0).map((metres) => bounded(Math.floor(metres / side)));
    const [east, south] = view.toWorld(view.width, view.height).map((metres) => bounded(Math.floor(metres / side)));
    const tiles = [];
    for (let z = north; z <= south; z += 1) {
      for (let x = west; x <= east; x += 1) {
        const away = Math.hypot((x + 0.5) * side - view.x, (z + 0.5) * side - view.z);
        tiles.push({ level, x, z, key: `${level}/${x}/${z}`, away });
      }
    }
    return tiles.sort((a, b) => a.away - b.away);
  }

  // The rectangle of a tile on the canvas, in whole device pixels, so that neighbours meet.
  #box({ level, x, z }, ratio) {
    const side = this.world.level_0_side_m * 2 ** level;
    const corner = (x, z) => this.view.toScreen(x * side, z * side).map((pixel) => Math.round(pixel * ratio));
    return [...corner(x, z), ...corner(x + 1, z + 1)];
  }

  #image(key) {
    const image = this.#kept.get(key);
    if (image) {
      // Least recently used eviction.
      this.#kept.delete(key);
      this.#kept.set(key, image);
    }
    return image;
  }

  #drawAncestor({ level, x, z }, left, top, width, height) {
    for (let up = 1; up <= ANCESTORS && level + up <= this.topLevel; up += 1) {
      const parts = 2 ** up;
      const [px, pz] = [Math.floor(x / parts), Math.floor(z / parts)];
      const image = this.#image(`${level + up}/${px}/${pz}`);
      if (image) {
        const side = this.pixels / parts;
        const [sx, sz] = [(x - px * parts) * side, (z - pz * parts) * side];
        this.context.drawImage(image, sx, sz, side, side, left, top, width, height);
        return;
      }
    }
  }

  #drawChildren({ level, x, z }, ratio) {
    for (const [dx, dz] of [[0, 0], [1, 0], [0, 1], [1, 1]]) {
      const child = { level: level - 1, x: 2 * x + dx, z: 2 * z + dz };
      const image = this.#kept.get(`${child.level}/${child.x}/${child.z}`);
      if (image) {
        const [left, top, right, bottom] = this.#box(child, ratio);
        this.context.drawImage(image, left, top, right - left, bottom - top);
      }
    }
  }

  #load(missing) {
    const wanted = new Set(missing.map((tile) => tile.key));
    for (const [key, loading] of this.#loading) {
      if (!wanted.has(key)) {
        loading.abort();
        this.#loading.delete(key);
      }
    }
    const now = performance.now();
    for (const tile of missing) {
      if (this.#loading.size >= AT_ONCE) break;
      if (!this.#loading.has(tile.key) && !(this.#failed.get(tile.key)?.until > now)) this.#fetch(tile);
    }
  }

  async #fetch({ level, x, z, key }) {
    const abort = new AbortController();
    this.#loading.set(key, abort);
    const address = this.world.map.replace('{level}', level).replace('{x}', x).replace('{z}', z);
    let again = 0;
    try {
      const answer = await this.request(address, { signal: abort.signal });
      if (answer.ok) {
        const image = await createImageBitmap(await answer.blob());
        this.#keep(key, image);
        this.#failed.delete(key);
      } else {
        again = 1000 * Number.parseFloat(answer.headers.get('Retry-After') ?? '5');
      }
    } catch {
      again = abort.signal.aborted ? 0 : 1000;
    }
    // An aborted tile may have been requested again meanwhile.
    if (this.#loading.get(key) === abort) this.#loading.delete(key);
    if (again > 0) {
      const tries = (this.#failed.get(key)?.tries ?? 0) + 1;
      const wait = Math.min(MAX_WAIT_MS, again * 2 ** (tries - 1));
      this.#failed.set(key, { tries, until: performance.now() + wait });
      setTimeout(() => this.update(), wait + 1);
    }
    this.update();
  }

  #keep(key, image) {
    this.#kept.set(key, image);
    for (const [oldest, dropped] of this.#kept) {
      if (this.#kept.size <= KEPT) break;
      dropped.close();
      this.#kept.delete(oldest);
    }
    // Removes old failures.
    if (this.#failed.size > KEPT) this.#failed.clear();
  }
}
