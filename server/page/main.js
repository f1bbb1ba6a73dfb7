// The page: asks the server what world it has, then shows its map, its clients and its figures, and says when it is away.

import { Clients } from './clients.js';
import { Panel, whereabouts } from './panel.js';
import { Tiles } from './tiles.js';
import { View } from './view.js';

const ASK_EVERY_MS = 1000;
const MAX_WAIT_MS = 5000;
const HEIGHT_AFTER_MS = 120;
const LIMIT_MS = 8000;

const byId = (id) => document.getElementById(id);
const token = { text: sessionStorage.getItem('token'), refused: false };

// Everything that the page asks goes through here.
async function ask(address, options = {}) {
  if (token.refused) throw new Error('locked');
  const { text } = token;
  const limit = AbortSignal.timeout(LIMIT_MS);
  const signal = options.signal ? AbortSignal.any([options.signal, limit]) : limit;
  const headers = text ? { Authorization: `Bearer ${text}` } : {};
  const answer = await fetch(address, { ...options, headers, signal });
  // Unless another token was entered meanwhile.
  if (answer.status === 401 && text === token.text) lock();
  return answer;
}

const pause = (milliseconds) => new Promise((done) => { setTimeout(done, milliseconds); });

function say(state, text, notice = '') {
  if (document.body.dataset.state === state) return;
  document.body.dataset.state = state;
  byId('state').textContent = text;
  byId('notice').textContent = notice;
  byId('notice').hidden = notice === '';
}

function lock() {
  token.refused = true;
  byId('token').hidden = false;
  say('locked', 'Locked');
}

async function askWorld() {
  const answer = await ask('/v1/world');
  if (!answer.ok) throw new Error(`status ${answer.status}`);
  return answer.json();
}

// Waits for the server, however long it takes.
async function untilWorld() {
  for (let wait = ASK_EVERY_MS; ; wait = Math.min(MAX_WAIT_MS, wait * 1.5)) {
    try {
      return await askWorld();
    } catch {
      away();
      await pause(wait);
    }
  }
}

function away() {
  say('away', 'Away', 'The server does not answer. Trying again …');
}

// Asks what happens once a second, less often while nobody answers, not at all while nobody looks.
async function watch(world, tiles, clients, panel) {
  let wait = ASK_EVERY_MS;
  for (;;) {
    if (document.hidden) await new Promise((seen) => { addEventListener('visibilitychange', seen, { once: true }); });
    const start = performance.now();
    if (token.refused) {
      await pause(ASK_EVERY_MS / 4);
      continue;
    }
    try {
      if (document.body.dataset.state === 'away') {
        const { digest } = await askWorld();
        // The same address, another world: begin anew.
        if (digest !== world.digest) location.reload();
      }
      const answer = await ask('/v1/live');
      if (answer.ok) {
        const report = await answer.json();
        if (document.body.dataset.state === 'away') tiles.retry();
        say('live', 'Live');
        clients.report(report.sessions.listed);
        panel.report(report);
      } else if (answer.status !== 401) {
        throw new Error(`status ${answer.status}`);
      }
      wait = ASK_EVERY_MS;
    } catch {
      away();
      wait = Math.min(MAX_WAIT_MS, wait * 1.5);
    }
    await pause(Math.max(200, wait - (performance.now() - start)));
  }
}

function showScale(view) {
  const limit = 110 * view.metresPerPixel;
  const decade = 10 ** Math.floor(Math.log10(limit));
  const metres = [5, 2, 1].find((step) => step * decade <= limit) * decade;
  byId('scale-bar').style.width = `${metres / view.metresPerPixel}px`;
  byId('scale-text').textContent = metres < 1000 ? `${metres} m` : `${metres / 1000} km`;
}

// The place under the pointer, or in the middle of the screen, with its height a moment later.
class Place {
  #pointer = null;
  #timer = 0;
  #asking = null;

  constructor(view, world) {
    Object.assign(this, { view, world });
    view.onChange(() => this.update());
    view.element.addEventListener('pointermove', (event) => {
      this.#pointer = event.pointerType === 'touch' ? null : [event.offsetX, event.offsetY];
      this.update();
    });
    view.element.addEventListener('pointerleave', () => { this.#pointer = null; this.update(); });
    this.update();
  }

  update() {
    const { view, world } = this;
    const [x, z] = view.toWorld(...(this.#pointer ?? [view.width / 2, view.height / 2])).map(Math.floor);
    clearTimeout(this.#timer);
    this.#asking?.abort();
    const inside = [x, z].every((metres) => metres >= -world.world_half_m && metres < world.world_half_m);
    byId('place').textContent = inside ? whereabouts(x, z) : 'outside the world';
    if (!inside) return;
    this.#timer = setTimeout(() => this.#height(x, z), HEIGHT_AFTER_MS);
  }

  async #height(x, z) {
    this.#asking = new AbortController();
    try {
      const address = this.world.heights.replace('{x}', x).replace('{z}', z);
      const answer = await ask(address, { signal: this.#asking.signal });
      if (!answer.ok) return;
      const { height_m: height } = await answer.json();
      const text = height < 0 ? `${(-height).toFixed(1)} m deep` : `${height.toFixed(1)} m high`;
      byId('place').textContent = `${whereabouts(x, z)}, ${text}`;
    } catch {
      // Moved on, or away: the coordinates alone are right.
    }
  }
}

function showCommand() {
  const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
  const command = `tombolo-view --connect ${scheme}://${location.host}/v1/stream`;
  byId('command').textContent = command;
  if (!navigator.clipboard) return;
  byId('copy').hidden = false;
  byId('copy').addEventListener('click', async () => {
    try {
      await navigator.clipboard.writeText(command);
      byId('copy').textContent = 'Copied';
    } catch {
      byId('copy').textContent = 'Not allowed';
    }
    await pause(1500);
    byId('copy').textContent = 'Copy';
  });
}

async function main() {
  showCommand();
  const world = await untilWorld();
  byId('world').textContent = `World ${world.world_seed} · ${world.digest.slice(0, 8)} · ${world.server.replace('tombolo-server ', 'v')}`;
  document.title = `Tombolo · world ${world.world_seed}`;
  const view = new View(byId('map'), world);
  const tiles = new Tiles(byId('relief'), view, world, ask);
  const clients = new Clients(byId('clients'), view);
  const panel = new Panel(view);
  new Place(view, world);
  view.onChange(() => showScale(view));
  showScale(view);
  byId('closer').addEventListener('click', () => view.zoomBy(-1));
  byId('farther').addEventListener('click', () => view.zoomBy(1));
  byId('home').addEventListener('click', () => view.home());
  byId('token').addEventListener('submit', (event) => {
    event.preventDefault();
    Object.assign(token, { text: byId('token-text').value, refused: false });
    sessionStorage.setItem('token', token.text);
    byId('token').hidden = true;
    say('starting', 'Connecting');
    tiles.retry();
  });
  await watch(world, tiles, clients, panel);
}

main();
