// The connected clients: an arrow per client with its heading and view cone, animated between two reports.

const SVG = 'http://www.w3.org/2000/svg';
const REPORT_MS = 1000;
// Maximum number of labelled clients; more labels would cover the map.
const LABELLED = 40;
const ARROW = 'M0 -11 L8 9 L0 5 L-8 9 Z';
const CONE = 'M0 0 L-26 -46 A53 53 0 0 1 26 -46 Z';
// An arrow this many pixels outside the screen is not visible.
const MARGIN = 60;

function element(name, attributes = {}) {
  const created = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) created.setAttribute(key, value);
  return created;
}

export class Clients {
  #shown = new Map();
  #frame = 0;

  constructor(svg, view) {
    Object.assign(this, { svg, view });
    view.onChange(() => this.#update());
  }

  // Updates the clients from a report.
  report(sessions) {
    const now = performance.now();
    const present = new Set();
    for (const { session, view } of sessions) {
      if (!view) continue;
      present.add(session);
      const client = this.#shown.get(session) ?? this.#add(session, view);
      client.from = this.#at(client, now);
      client.to = view;
      client.since = now;
    }
    for (const [session, client] of this.#shown) {
      if (!present.has(session)) {
        client.group.remove();
        this.#shown.delete(session);
      }
    }
    this.svg.classList.toggle('crowded', this.#shown.size > LABELLED);
    this.svg.dataset.shown = this.#shown.size;
    this.#update();
  }

  #add(session, view) {
    const group = element('g', { class: 'client' });
    const turned = element('g');
    turned.append(element('path', { class: 'cone', d: CONE }), element('path', { class: 'arrow', d: ARROW }));
    const label = element('text', { x: 12, y: 4 });
    label.textContent = session;
    group.append(turned, label);
    this.svg.append(group);
    const client = { group, turned, label, from: view, to: view, since: 0 };
    this.#shown.set(session, client);
    return client;
  }

  #at({ from, to, since }, now) {
    const share = this.view.calm.matches ? 1 : Math.min(1, Math.max(0, now - since) / REPORT_MS);
    const mix = (a, b) => a + (b - a) * share;
    // The shorter direction of rotation.
    const turn = ((to.heading_deg - from.heading_deg + 540) % 360) - 180;
    return {
      x_m: mix(from.x_m, to.x_m),
      z_m: mix(from.z_m, to.z_m),
      heading_deg: from.heading_deg + turn * share,
    };
  }

  #update() {
    this.#frame ||= requestAnimationFrame((now) => {
      this.#frame = 0;
      this.#draw(now);
    });
  }

  #draw(now) {
    let moving = false;
    const labelled = this.#shown.size <= LABELLED;
    for (const client of this.#shown.values()) {
      const { x_m, z_m, heading_deg } = this.#at(client, now);
      const [x, y] = this.view.toScreen(x_m, z_m);
      const { width, height } = this.view;
      const visible = x > -MARGIN && y > -MARGIN && x < width + MARGIN && y < height + MARGIN;
      client.group.setAttribute('visibility', visible ? 'visible' : 'hidden');
      client.group.setAttribute('transform', `translate(${x.toFixed(1)} ${y.toFixed(1)})`);
      client.turned.setAttribute('transform', `rotate(${heading_deg.toFixed(1)})`);
      client.label.setAttribute('visibility', visible && labelled ? 'visible' : 'hidden');
      const { from, to } = client;
      const changes = from.x_m !== to.x_m || from.z_m !== to.z_m || from.heading_deg !== to.heading_deg;
      moving ||= visible && changes && now - client.since < REPORT_MS && !this.view.calm.matches;
    }
    if (moving) this.#update();
  }
}
