// The page: reads the description of the world, shows its map, clients and statistics, and reports outages.

import { Clients } from './clients.js';
import { Panel, formatPosition } from './panel.js';
import { Tiles } from './tiles.js';
import { View } from './view.js';

const POLL_MS = 1000;
const MAX_RETRY_MS = 5000;
const HEIGHT_DELAY_MS = 120;
const TIMEOUT_MS = 8000;

const byId = (id) => document.getElementById(id);
const token = { text: sessionStorage.getItem('token'), refused: false };

// All requests of the page.
async function request(address, options = {}) {
  if (token.refused) throw new Error('locked');
  const { text } = token;
  const limit = AbortSignal.timeout(TIMEOUT_MS);
  const signal = options.signal ? AbortSignal.any([options.signal, limit]) : limit;
  const headers = text ? { Authorization: `Bearer ${text}` } : {};
  const answer = await fetch(address, { ...options, headers, signal });
  // Unless another token has been entered meanwhile.
  if (answer.status === 401 && text === token.text) lock();
  return answer;
}

const pause = (milliseconds) => new Promise((done) => { setTimeout(done, milliseconds); });

function showState(state, text, notice = '') {
  if (document.body.dataset.state === state) return;
  document.body.dataset.state = state;
  byId('state').textContent = text;
  byId('notice').textContent = notice;
  byId('notice').hidden = notice === '';
}

function lock() {
  token.refused = true;
  byId('token').hidden = false;
  showState('locked', 'Locked');
}

async function fetchWorld() {
  const answer = await request('/v1/world');
  if (!answer.ok) throw new Error(`status ${answer.status}`);
  return answer.json();
}

// Retries until the server responds.
async function waitForWorld() {
  for (let wait = POLL_MS; ; wait = Math.min(MAX_RETRY_MS, wait * 1.5)) {
    try {
      return await fetchWorld();
    } catch {
      outage();
      await pause(wait);
    }
  }
}

function outage() {
  showState('away', 'Away', 'The server does not answer. Trying again …');
}

// Polls the statistics once per second, less often during an outage, and not while the page is hidden.
async function poll(world, tiles, clients, panel) {
  let wait = POLL_MS;
  for (;;) {
    if (document.hidden) await new Promise((visible) => { addEventListener('visibilitychange', visible, { once: true }); });
    const start = performance.now();
    if (token.refused) {
      await pause(POLL_MS / 4);
      continue;
    }
    try {
      if (document.body.dataset.state === 'away') {
        const { digest } = await fetchWorld();
        // The server has another world now.
        if (digest !== world.digest) location.reload();
      }
      const answer = await request('/v1/live');
      if (answer.ok) {
        const report = await answer.json();
        if (document.body.dataset.state === 'away') tiles.retry();
        showState('live', 'Live');
        clients.report(report.sessions.listed);
        panel.report(report);
      } else if (answer.status !== 401) {
        throw new Error(`status ${answer.status}`);
      }
      wait = POLL_MS;
    } catch {
      outage();
      wait = Math.min(MAX_RETRY_MS, wait * 1.5);
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

// The position under the pointer or at the centre of the screen, and its height after a delay.
class PositionDisplay {
  #pointer = null;
  #timer = 0;
  #pending = null;

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
    this.#pending?.abort();
    const inside = [x, z].every((metres) => metres >= -world.world_half_m && metres < world.world_half_m);
    byId('place').textContent = inside ? formatPosition(x, z) : 'outside the world';
    if (!inside) return;
    this.#timer = setTimeout(() => this.#height(x, z), HEIGHT_DELAY_MS);
  }

  async #height(x, z) {
    this.#pending = new AbortController();
    try {
      const address = this.world.heights.replace('{x}', x).replace('{z}', z);
      const answer = await request(address, { signal: this.#pending.signal });
      if (!answer.ok) return;
      const { height_m: height } = await answer.json();
      const text = height < 0 ? `${(-height).toFixed(1)} m deep` : `${height.toFixed(1)} m high`;
      byId('place').textContent = `${formatPosition(x, z)}, ${text}`;
    } catch {
      // Aborted or failed: the coordinates stay.
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
  const world = await waitForWorld();
  byId('world').textContent = `World ${world.world_seed} · ${world.digest.slice(0, 8)} · ${world.server.replace('tombolo-server ', 'v')}`;
  document.title = `Tombolo · world ${world.world_seed}`;
  const view = new View(byId('map'), world);
  const tiles = new Tiles(byId('relief'), view, world, request);
  const clients = new Clients(byId('clients'), view);
  const panel = new Panel(view);
  new PositionDisplay(view, world);
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
    showState('starting', 'Connecting');
    tiles.retry();
  });
  await poll(world, tiles, clients, panel);
}

main();
