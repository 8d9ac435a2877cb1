/// What a test of the viewer owns: built programs on free ports, a browser with a profile of its own, pictures of what was seen.
///
/// Invariant: everything started here is ended here by its handle; nothing waits for a time, only for what is to be seen.
import { execFile, spawn } from 'node:child_process';
import fs from 'node:fs';
import os from 'node:os';
import path from 'node:path';
import { chromium } from 'playwright-core';

export const BIN = process.env.TROCAR_BIN_DIR ?? path.resolve('../../release');
export const PLUGINS = process.env.TROCAR_PLUGIN_DIR ?? BIN;
export const PICTURES = path.resolve('pictures');
/// A wait fails when what it observes has not changed for so long, whatever it takes in all, ms.
export const STANDSTILL = 60_000;
const ARGS = [
  '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking',
  '--disable-component-update', '--disable-sync', '--disable-dev-shm-usage',
];

const launch = (args) => chromium.launch({ executablePath: process.env.CHROMIUM, headless: true, args });
/// The browser of all tests, which takes long to start; one that has ended is replaced.
let shared;
async function sharedBrowser() {
  if (!shared?.isConnected()) shared = await launch(ARGS);
  return shared;
}
export const endBrowser = () => shared?.close();

/// A program of ours, and what it printed.
class Program {
  constructor(args, name, env = {}, cwd = undefined) {
    this.name = name;
    this.printed = '';
    this.child = spawn(path.join(BIN, 'trocar'), args, { stdio: ['ignore', 'pipe', 'pipe'], cwd, env: { ...process.env, NO_COLOR: '1', ...env } });
    this.ended = new Promise((over) => this.child.once('exit', (code, signal) => over(signal ?? code)));
    for (const stream of [this.child.stdout, this.child.stderr]) stream.on('data', (text) => (this.printed = (this.printed + text).slice(-60_000)));
    this.ready = new Promise((yes, no) => {
      const look = () => {
        const found = /listening(?: on |": ?")(127\.0\.0\.1:\d+)/.exec(this.printed);
        if (found) yes((this.addr = found[1]));
      };
      this.child.stdout.on('data', look);
      this.ended.then((how) => no(new Error(`${name} ended (${how}) before it listened:\n${this.printed}`)));
    });
  }
  kill(signal) {
    this.child.kill(signal);
  }
}

export class World {
  programs = [];
  contexts = [];
  browsers = [];
  constructor() {
    this.dir = fs.mkdtempSync(path.join(os.tmpdir(), 'trocar-viewer-'));
  }
  async start(args, name, { cwd } = {}) {
    const program = new Program(args, name, { XDG_STATE_HOME: path.join(this.dir, 'state'), HOME: this.dir }, cwd);
    this.programs.push(program);
    await Promise.race([program.ready, eventually(`${name} listens`, () => program.addr, () => program.printed)]);
    return program;
  }
  host(name = 'host', more = [], options = {}) {
    return this.start(['host', '--name', name, '--plugins', PLUGINS, '--listen', '127.0.0.1:0', '--state', path.join(this.dir, name), ...more], name, options);
  }
  gcm(listen = '127.0.0.1:0') {
    return this.start(['gcm', '--listen', listen, '--state', path.join(this.dir, 'gcm')], 'gcm');
  }
  demo(more = []) {
    return this.start(['demo', '--plugins', PLUGINS, '--listen', '127.0.0.1:0', ...more], 'demo');
  }
  /// A profile of its own: windows of one profile share what it may have open to one address. With `args` in
  /// a browser of its own, too.
  async browser({ args, ...options } = {}) {
    const browser = await (args ? launch(args) : sharedBrowser());
    if (args) this.browsers.push(browser);
    const context = await browser.newContext({ viewport: { width: 1500, height: 900 }, ...options });
    context.setDefaultTimeout(STANDSTILL);
    // For work on the page: files of a build that no program embeds yet.
    if (process.env.VIEWER_DIST) {
      await context.route(/^http:[/][/]127\.0\.0\.1:\d+[/](video|icon\.svg|assets[/].*)?(\?.*)?$/, async (route) => {
        const asked = new URL(route.request().url()).pathname;
        const file = path.join(process.env.VIEWER_DIST, asked === '/' || asked === '/video' ? 'index.html' : asked);
        if (file.endsWith('index.html')) {
          // What the program says of itself in the page stays.
          const told = /<meta name="viewer"[^>]*>/.exec(await (await route.fetch()).text())?.[0];
          const built = fs.readFileSync(file, 'utf8').replace(/<meta name="viewer"[^>]*>/, told ?? '');
          await route.fulfill({ body: built, contentType: 'text/html; charset=utf-8' });
        } else if (fs.existsSync(file)) await route.fulfill({ path: file });
        else await route.continue();
      });
    }
    this.contexts.push(context);
    return context;
  }
  /// The viewer in a browser of its own; what goes wrong in it fails the test.
  async viewer(addr, query = '', options = {}) {
    const context = await this.browser(options);
    const page = await context.newPage();
    page.wrong = [];
    page.on('pageerror', (e) => page.wrong.push(String(e.stack ?? e)));
    page.on('console', (m) => {
      if (m.type() === 'error' && !/Failed to load resource|ERR_CONNECTION|ERR_INCOMPLETE|ERR_EMPTY/.test(m.text())) page.wrong.push(m.text());
    });
    await page.goto(`http://${addr}/${query}`);
    await page.waitForSelector('[data-standing=live]');
    return page;
  }
  async end() {
    for (const one of [...this.contexts, ...this.browsers]) await one.close().catch(() => {});
    for (const p of this.programs) p.kill('SIGINT');
    for (const p of this.programs) {
      const late = setTimeout(() => p.kill('SIGKILL'), 10_000);
      await p.ended;
      clearTimeout(late);
    }
    fs.rmSync(this.dir, { recursive: true, force: true });
  }
}

/// Goes by Ctrl-K to what has this name, as soon as the page knows it.
export async function reveal(page, name) {
  await page.keyboard.press('Control+k');
  await page.getByRole('combobox', { name: 'search' }).fill(name);
  await page.locator('#found [role=option][aria-selected=true]', { hasText: name }).waitFor();
  await page.keyboard.press('Enter');
}

/// grpcurl's answer; a refusal is thrown in its own words.
export function grpcurl(addr, method, request = {}) {
  return new Promise((yes, no) => {
    execFile(process.env.GRPCURL, ['-plaintext', '-d', JSON.stringify(request), addr, `trocar.v1.${method}`], { maxBuffer: 64 << 20 }, (error, out, said) =>
      error ? no(new Error(`${method} ${JSON.stringify(request)}: ${said}`)) : yes(JSON.parse(out)),
    );
  });
}

/// Asks until it is so. `progress` is observed beside the answer: a count or a state on the way there.
export async function eventually(what, ask, progress = () => '') {
  let [last, since] = [undefined, Date.now()];
  for (;;) {
    let answer;
    try {
      answer = await ask();
      if (answer) return answer;
    } catch (e) {
      answer = e;
    }
    const now = `${answer} ${JSON.stringify(await Promise.resolve().then(progress).catch(String))}`;
    if (now !== last) [last, since] = [now, Date.now()];
    else if (Date.now() - since > STANDSTILL) throw new Error(`${what}: nothing has changed for ${STANDSTILL / 1000} s; last: ${now}`);
    await new Promise((next) => setTimeout(next, 50));
  }
}

/// Waits until all of the counts are so large; each change of them is progress.
export const reaches = (what, counts, least) => eventually(what, async () => [await counts()].flat().every((n) => n >= least), counts);

export function is(found, wanted, what) {
  if (JSON.stringify(found) !== JSON.stringify(wanted)) throw new Error(`${what}: ${JSON.stringify(found)}, wanted ${JSON.stringify(wanted)}`);
}

export function holds(yes, what) {
  if (!yes) throw new Error(what);
}

export async function shot(page, name) {
  fs.mkdirSync(PICTURES, { recursive: true });
  await page.screenshot({ path: path.join(PICTURES, `${name}.png`) });
}

export const create = (addr, cls, p, config, execution) => grpcurl(addr, 'GcmService/Create', { path: p, class: cls, config, execution });
export const start = (addr, ...paths) => grpcurl(addr, 'GcmService/Start', { paths });
export const connect = (addr, client, server) => grpcurl(addr, 'GcmService/Connect', { client, server });
export const state = async (addr, p) => (await grpcurl(addr, 'GcmService/GetState', { path: p })).component.state?.replace('COMPONENT_STATE_', '');

/// A sine in the process `left` that feeds an echo in the process `right`, both under one GCM.
export async function twoProcesses(world) {
  const gcm = await world.gcm();
  const left = await world.host('left', ['--gcm', gcm.addr]);
  const right = await world.host('right', ['--gcm', gcm.addr]);
  await create(gcm.addr, 'sine', 'left/sine');
  await create(gcm.addr, 'echo', 'right/echo');
  await connect(gcm.addr, 'right/echo/sample', 'left/sine/value');
  await start(gcm.addr, 'left/sine', 'right/echo');
  return { gcm, left, right };
}

/// The box of a component on the page.
export const box = (page, p) => page.locator(`[data-path="${p}"]`);
/// Chooses from the menu of a component.
export async function menu(page, p, item) {
  await box(page, p).locator('header').click({ button: 'right' });
  await page.getByRole('menuitem', { name: new RegExp(`^${item}`) }).click();
}
/// Presses a button of the top, in its menu where it has no room.
export async function tool(page, name) {
  const button = page.locator('.tools').getByRole('button', { name, exact: true });
  if (await button.count()) return button.click();
  await page.getByRole('button', { name: 'Menu', exact: true }).click();
  await page.locator('.menu button', { hasText: name }).first().click();
}
/// The middle of a port's handle.
export async function handle(page, port) {
  const [at, name] = [port.slice(0, port.lastIndexOf('/')), port.slice(port.lastIndexOf('/') + 1)];
  const found = await page.locator(`[data-path="${at}"] [data-handleid="${name}"]`).boundingBox();
  return { x: found.x + found.width / 2, y: found.y + found.height / 2 };
}
/// Where something is, once it stands still.
export async function still(of) {
  let before = '';
  return eventually('it stands still', async () => {
    const now = await of.boundingBox();
    const same = JSON.stringify(now) === before;
    before = JSON.stringify(now);
    return same && now;
  });
}

/// Waits until the layout has put everything where it stays and the view fits it: seen twice, with two frames in between. A box grows
/// by its ports, which come after it.
export async function settled(page) {
  const places = () => {
    if (!document.querySelector('.laid-out')) return '';
    const all = [...document.querySelectorAll('[data-path]')].map((box) => {
      const { x, y } = box.getBoundingClientRect();
      return box.querySelector('[data-port]') && `${Math.round(x)},${Math.round(y)}`;
    });
    return all.every(Boolean) ? all.join(' ') : '';
  };
  let before = '';
  await eventually('the graph stands still', async () => {
    const now = await page.evaluate(places);
    const same = now !== '' && now === before;
    before = now;
    if (!same) await page.evaluate(() => new Promise((r) => requestAnimationFrame(() => requestAnimationFrame(r))));
    return same;
  });
}
