// Statistics with their history, and the list of clients.

const SVG = 'http://www.w3.org/2000/svg';
// Values in the history: one minute.
const HISTORY = 60;
const LISTED = 6;

const byId = (id) => document.getElementById(id);
const [whole, tenths] = [0, 1].map((digits) => new Intl.NumberFormat('en', { maximumFractionDigits: digits, minimumFractionDigits: digits }));
const NONE = '–';

const short = (value) => {
  if (value === null || value === undefined) return NONE;
  return (value > 0 && value < 9.95 ? tenths : whole).format(value);
};

const bytesPerSecond = (value) => {
  if (value === null || value === undefined) return [NONE, 'kB/s'];
  const [unit, size] = [['GB/s', 1e9], ['MB/s', 1e6]].find(([, size]) => value >= size) ?? ['kB/s', 1e3];
  return [short(value / size), unit];
};

const duration = (seconds) => {
  const [days, hours, minutes] = [Math.floor(seconds / 86400), Math.floor(seconds / 3600) % 24, Math.floor(seconds / 60) % 60];
  if (days > 0) return `${days} d ${hours} h`;
  if (hours > 0) return `${hours} h ${minutes} min`;
  return minutes > 0 ? `${minutes} min ${Math.floor(seconds) % 60} s` : `${Math.floor(seconds)} s`;
};

const kilometres = (metres) => (metres < 10000 ? `${whole.format(metres)} m` : `${tenths.format(metres / 1000)} km`);

// A position as distances and directions from the centre of the world.
export const formatPosition = (x, z) =>
  `${kilometres(Math.abs(x))} ${x < 0 ? 'W' : 'E'}, ${kilometres(Math.abs(z))} ${z < 0 ? 'N' : 'S'}`;

// A sparkline of the history, with gaps for missing values.
class Sparkline {
  #values = [];

  constructor(id) {
    this.svg = byId(id);
    this.svg.setAttribute('viewBox', `0 0 ${HISTORY - 1} 100`);
    this.svg.setAttribute('preserveAspectRatio', 'none');
    [this.area, this.curve] = ['area', 'curve'].map((name) => {
      const path = document.createElementNS(SVG, 'path');
      path.setAttribute('class', name);
      this.svg.append(path);
      return path;
    });
  }

  push(value) {
    this.#values = [...this.#values, value ?? null].slice(-HISTORY);
    const top = Math.max(1e-9, ...this.#values.map((value) => value ?? 0)) * 1.08;
    const first = HISTORY - this.#values.length;
    let [curve, area, start] = ['', '', null];
    const close = (end) => { if (start !== null) area += `L${end} 100L${start} 100Z`; start = null; };
    this.#values.forEach((value, index) => {
      const x = first + index;
      if (value === null) {
        close(x - 1);
        return;
      }
      const point = `${x} ${(98 - (value / top) * 96).toFixed(1)}`;
      curve += `${start === null ? 'M' : 'L'}${point}`;
      area += `${start === null ? 'M' : 'L'}${point}`;
      start ??= x;
    });
    close(HISTORY - 1);
    this.curve.setAttribute('d', curve);
    this.area.setAttribute('d', area);
  }
}

export class Panel {
  #sparks = Object.fromEntries(['clients', 'chunks', 'bytes', 'latency'].map((name) => [name, new Sparkline(`spark-${name}`)]));

  constructor(view) {
    this.view = view;
    byId('more').addEventListener('click', () => {
      const open = byId('panel').classList.toggle('open');
      byId('more').setAttribute('aria-expanded', String(open));
      byId('more').textContent = open ? 'Less' : 'More';
    });
  }

  report({ sessions, sent, latency, generation, uptime_s: uptime }) {
    const set = (id, text) => { byId(id).value = text; };
    set('clients-open', whole.format(sessions.open));
    set('chunks', short(sent?.chunks_per_s));
    const [bytes, unit] = bytesPerSecond(sent?.bytes_per_s);
    set('bytes', bytes);
    byId('bytes-unit').textContent = unit;
    set('latency', short(latency?.p99_ms));
    set('latency-half', short(latency?.p50_ms));
    set('made', short(generation.chunks_per_s));
    set('queue', whole.format(generation.queue));
    set('uptime', duration(uptime));
    this.#sparks.clients.push(sessions.open);
    this.#sparks.chunks.push(sent?.chunks_per_s);
    this.#sparks.bytes.push(sent?.bytes_per_s);
    this.#sparks.latency.push(latency?.p99_ms);
    this.#list(sessions);
  }

  #list({ open, listed }) {
    const placed = listed.filter(({ view }) => view);
    const busiest = [...placed].sort((a, b) => (b.bytes_per_s ?? 0) - (a.bytes_per_s ?? 0) || a.session - b.session);
    const list = byId('list');
    // Entries are reused, so that the focus stays.
    busiest.slice(0, LISTED).sort((a, b) => a.session - b.session).forEach((client, index) => {
      const entry = list.children[index] ?? this.#entry(list);
      const { session, view } = client;
      const [number, where, rate] = entry.firstChild.children;
      number.textContent = session;
      where.textContent = formatPosition(view.x_m, view.z_m);
      rate.textContent = `${short(client.chunks_per_s)} /s`;
      entry.firstChild.setAttribute('aria-label', `Show session ${session}`);
      entry.target = view;
    });
    while (list.children.length > Math.min(LISTED, placed.length)) list.lastChild.remove();
    const rest = open - list.children.length;
    byId('rest').textContent = open === 0 ? 'No client is connected.' : rest > 0 ? `and ${whole.format(rest)} more` : '';
  }

  #entry(list) {
    const entry = document.createElement('li');
    const button = document.createElement('button');
    button.type = 'button';
    for (const name of ['number', 'where', 'rate']) {
      const part = document.createElement('span');
      part.className = name;
      button.append(part);
    }
    button.addEventListener('click', () => {
      this.view.goTo({ x: entry.target.x_m, z: entry.target.z_m, level: Math.min(this.view.level, 3) });
    });
    entry.append(button);
    list.append(entry);
    return entry;
  }
}
