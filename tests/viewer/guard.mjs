/// Foreign web sites: what a browser lets them try, and what becomes of it.
import http from 'node:http';
import { box, create, eventually, holds, is, settled, state } from './world.mjs';

async function site(html) {
  const server = http.createServer((_, answer) => answer.setHeader('content-type', 'text/html').end(html));
  await new Promise((up) => server.listen(0, '127.0.0.1', up));
  return server;
}

export async function a_foreign_page_can_neither_change_nor_read_nor_frame_anything(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  const foreign = await site('<title>elsewhere</title><body></body>');
  try {
    const context = await world.browser();
    const page = await context.newPage();
    await page.goto(`http://127.0.0.1:${foreign.address().port}/`);
    const tried = await page.evaluate(async (addr) => {
      // Start of host/sine: field 1, length 9.
      const body = new Uint8Array([0, 0, 0, 0, 11, 10, 9, ...new TextEncoder().encode('host/sine')]);
      const out = [];
      for (const [mode, type] of [['cors', 'application/grpc-web+proto'], ['no-cors', 'text/plain'], ['cors', 'text/plain']]) {
        out.push(await fetch(`http://${addr}/trocar.v1.GcmService/Start`, { method: 'POST', mode, body, headers: { 'content-type': type } }).then((r) => `${r.type} ${r.status}`, (e) => e.name));
      }
      out.push(await fetch(`http://${addr}/healthz`).then((r) => r.text(), (e) => e.name));
      const frame = document.createElement('iframe');
      frame.src = `http://${addr}/`;
      const loaded = new Promise((over) => (frame.onload = over));
      document.body.append(frame);
      await loaded;
      out.push(frame.contentDocument === null ? 'frame closed' : 'frame open');
      return out;
    }, host.addr);
    // A browser may hide that it was answered at all.
    holds(tried.every((t) => ['TypeError', 'opaque 0', 'frame closed'].includes(t)) && tried.at(-1) === 'frame closed', `what a foreign page was answered: ${tried}`);
    for (const frame of page.frames()) is(await frame.locator('#app').count(), 0, `viewers in a foreign page's frame ${frame.url()}`);
    is(await state(host.addr, 'host/sine'), 'READY', 'nothing was started');
    await eventually('the host says who tried', () => /a browser's request for .* was refused: .*only the viewer's own page/.test(host.printed));
  } finally {
    foreign.close();
  }
}

export async function a_name_lent_by_dns_is_refused_in_a_sentence(world) {
  const host = await world.host();
  const port = host.addr.split(':')[1];
  const context = await world.browser({ args: ['--no-sandbox', '--disable-gpu', '--host-resolver-rules=MAP robot.example 127.0.0.1'] });
  const page = await context.newPage();
  const answer = await page.goto(`http://robot.example:${port}/`);
  is(answer.status(), 403, 'status');
  const said = await answer.text();
  holds(said.includes('robot.example') && said.includes('http://localhost:PORT/'), said);
}

export async function the_page_obeys_its_own_policy(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  const page = await world.viewer(host.addr);
  await settled(page);
  await box(page, 'host/sine').waitFor();
  const policy = (await page.request.get(`http://${host.addr}/`)).headers()['content-security-policy'];
  for (const part of ["default-src 'none'", "script-src 'self'", "connect-src 'self'", "frame-ancestors 'none'"]) holds(policy.includes(part), policy);
  const ran = await page.evaluate(() => { const s = document.createElement('script'); s.textContent = 'window.ran = true'; document.head.append(s); return window.ran === true; });
  holds(!ran, 'a script that is not the page’s own ran');
  page.wrong = page.wrong.filter((w) => !/Content Security Policy/.test(w));
}
