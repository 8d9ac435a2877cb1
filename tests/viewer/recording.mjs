/// Recordings from the page: begun, seen and ended there, and read afterwards by the program.
///
/// Invariant: what the page says of a recording is compared with what its file holds.
import { execFile, spawn } from 'node:child_process';
import fs from 'node:fs';
import path from 'node:path';
import { BIN, connect, create, eventually, grpcurl, holds, is, PLUGINS, settled, shot, start } from './world.mjs';

const panel = (page) => page.locator('[data-record]');
const record = (page) => page.locator('[data-recording]');
const recorders = async (addr) => ((await grpcurl(addr, 'GcmService/List', { brief: true })).components ?? []).filter((c) => c.class === 'recorder/recorder').map((c) => c.path);

/// A host whose recorders write into a directory of the test's own.
async function recorded(world) {
  const host = await world.host('host', [], { cwd: world.dir });
  await create(host.addr, 'sine', 'host/sine');
  await create(host.addr, 'echo', 'host/echo');
  await connect(host.addr, 'host/echo/sample', 'host/sine/value');
  await start(host.addr, 'host/**');
  return host;
}

/// The content of a recording, as the program tells it.
function info(file) {
  return new Promise((yes, no) => execFile(path.join(BIN, 'trocar'), ['info', file, '--json'], { maxBuffer: 64 << 20 }, (error, out, said) => (out ? yes(JSON.parse(out)) : no(error ?? new Error(said)))));
}

/// `trocar record`, with its file in the test's directory.
function recordByProgram(world, addr, file, ...patterns) {
  const child = spawn(path.join(BIN, 'trocar'), ['--gcm', addr, 'record', ...patterns, '-o', file], { cwd: world.dir, stdio: ['ignore', 'pipe', 'pipe'] });
  const program = { name: 'trocar record', printed: '', kill: (signal) => child.kill(signal), ended: new Promise((over) => child.once('exit', (code, signal) => over(signal ?? code))) };
  for (const stream of [child.stdout, child.stderr]) stream.on('data', (text) => (program.printed += text));
  world.programs.push(program);
  return program;
}

async function open(page) {
  await record(page).click();
  await panel(page).waitFor();
}
async function begin(page, patterns) {
  await open(page);
  await page.getByLabel('Patterns').fill(patterns);
  await begin_here(page);
}
async function begin_here(page) {
  await page.locator('[data-matched]').waitFor();
  await panel(page).getByRole('button', { name: 'Start' }).click();
  await page.locator('[data-recorder$="/rec-viewer"][data-phase=RECORDING]').waitFor();
}
const figures = (page) => page.locator('[data-recorder] [data-figures]').innerText();
/// A recorder that no viewer made, with `host/sine/value` as its only input.
async function recorderOf(addr, component) {
  await create(addr, 'recorder/recorder', component, { topics: ['t0'], sources: ['host/sine/value'] });
  await connect(addr, `${component}/t0`, 'host/sine/value');
  await start(addr, component);
}
const command = async (addr, component, name, json) => (await grpcurl(addr, 'InteractService/Invoke', { path: `${component}/ctl/${name}`, json })).json;
const startOf = (file) => ({ path: file, delay: 0, duration: 0 });
/// After so long unseen a page has let go, ms; see UNSEEN in App.svelte.
const LONG = 6000;
/// Says in a browser's place whether the page is seen.
function seen(page, yes) {
  return page.evaluate((yes) => {
    Object.defineProperty(document, 'hidden', { configurable: true, get: () => !yes });
    document.dispatchEvent(new Event('visibilitychange'));
  }, yes);
}
/// Calls of the page that hold this text are answered with a status of gRPC.
const refuse = (page, method, text, status, words) => page.route(`**/*Service/${method}`, (route) =>
  route.request().postDataBuffer()?.includes(text) ? route.fulfill({ headers: { 'content-type': 'application/grpc-web+proto', 'grpc-status': String(status), 'grpc-message': words }, body: '' }) : route.fallback());
const messages = async (page) => Number(/(\d+) message/.exec(await page.locator('[data-recorder] [data-figures]').innerText())?.[1] ?? 0);

export async function a_recording_is_begun_seen_after_a_reload_and_ended_from_the_page(world) {
  const host = await recorded(world);
  const page = await world.viewer(host.addr);
  await settled(page);
  await begin(page, 'host/sine/value');
  is(await recorders(host.addr), ['host/rec-viewer'], 'recorders');
  await eventually('messages come', async () => (await messages(page)) > 100);
  await shot(page, 'recording');
  await page.reload();
  await eventually('the button tells time and size', async () => /\d:\d\d · [\d.]+ [kM]?B/.test(await record(page).innerText()));
  await open(page);
  const file = await page.locator('[data-recorder]').getAttribute('data-file');
  is([path.dirname(file), /^trial-\d{8}-\d{6}\.mcap$/.test(path.basename(file))], [fs.realpathSync(world.dir), true], `the file ${file}`);
  const before = await messages(page);
  await eventually('it goes on', async () => (await messages(page)) > before);
  await page.getByRole('button', { name: 'Stop', exact: true }).click();
  await page.locator('[data-recorder][data-phase=ENDED]').waitFor();
  await eventually('its recorder is taken away', async () => (await recorders(host.addr)).length === 0);
  await shot(page, 'recording-ended');
  is(await page.locator('[data-look]').innerText(), `trocar info ${file}`, 'how it is looked at');
  const read = await info(file);
  const inside = read.topics.filter((t) => !t.topic.startsWith('/recorder/'));
  is([read.whole, inside.map((t) => t.topic), read.lost], [true, ['/host/sine/value'], 0], 'what the file holds');
  is(await messages(page), read.messages, 'messages that the page tells, and that are in the file');
  holds((await page.locator('[data-recorder] [data-figures]').innerText()).includes('nothing lost'), 'the page says that nothing was lost');
  await page.getByRole('button', { name: 'Dismiss' }).click();
  await page.locator('[data-recorder]').waitFor({ state: 'detached' });
}

export async function the_page_makes_a_recorder_as_trocar_record_does(world) {
  const host = await recorded(world);
  const page = await world.viewer(host.addr);
  await settled(page);
  const patterns = ['host/sine', '*/ech?/**'];
  const program = recordByProgram(world, host.addr, 'program.mcap', ...patterns);
  await eventually('the program records', async () => (await recorders(host.addr)).length === 1, () => program.printed);
  await begin(page, patterns.join('\n'));
  const list = await grpcurl(host.addr, 'GcmService/List', {});
  const made = (of) => {
    const c = list.components.find((c) => c.class === 'recorder/recorder' && c.path.endsWith('rec-viewer') === of);
    const { directory, ...config } = c.config;
    const ties = list.connections.filter((t) => t.client.startsWith(`${c.path}/`)).map((t) => [t.client.slice(c.path.length), t.server, t.options]);
    return [c.execution, config, ties.sort()];
  };
  holds(made(true)[2].length > 5, `what is recorded: ${JSON.stringify(made(true))}`);
  is(made(true), made(false), 'what the page makes, and what the program makes');
}

export async function a_pattern_that_matches_nothing_says_so_with_the_nearest_names_and_starts_nothing(world) {
  const host = await recorded(world);
  const page = await world.viewer(host.addr);
  await settled(page);
  await open(page);
  await page.getByLabel('Patterns').fill('host/sine/value\nhost/sine/valeu\nnobody/**');
  await page.locator('[data-matched="1"]').waitFor();
  const said = await page.locator('[data-nothing]').allInnerTexts();
  is(said.length, 2, `lines of patterns that match nothing: ${said}`);
  holds(/“host\/sine\/valeu” matches no output; the nearest names are host\/sine\/value,/.test(said[0]) && said[1].includes('nobody/**'), `what is said: ${said}`);
  await shot(page, 'record-nothing');
  await panel(page).getByRole('button', { name: 'Start' }).click();
  await panel(page).getByRole('alert').filter({ hasText: 'Nothing was started' }).waitFor();
  is(await recorders(host.addr), [], 'recorders');
}

export async function a_start_that_is_refused_leaves_no_recorder_behind_and_says_why(world) {
  const host = await recorded(world);
  fs.writeFileSync(path.join(world.dir, 'there.mcap'), 'precious');
  const page = await world.viewer(host.addr);
  await settled(page);
  await open(page);
  await page.locator('[data-matched]').waitFor();
  for (const [file, why] of [['../out.mcap', 'leads out of the directory'], ['there.mcap', 'nothing is written over'], ['trial.txt', 'does not end with .mcap']]) {
    await page.getByLabel('File').fill(file);
    await panel(page).getByRole('button', { name: 'Start' }).click();
    await panel(page).getByRole('alert').filter({ hasText: why }).waitFor();
    is(await recorders(host.addr), [], `recorders after ${file}`);
  }
  await shot(page, 'record-refused');
  is(((await grpcurl(host.addr, 'GcmService/List', {})).connections ?? []).length, 1, 'connections');
  is(fs.readFileSync(path.join(world.dir, 'there.mcap'), 'utf8'), 'precious', 'the file that was there');
  // As soon as it is mended, it records.
  await page.getByLabel('File').fill('mended.mcap');
  await panel(page).getByRole('button', { name: 'Start' }).click();
  await page.locator('[data-recorder][data-phase=RECORDING]').waitFor();
  is(path.basename(await page.locator('[data-recorder]').getAttribute('data-file')), 'mended.mcap', 'the file');
}

export async function a_recording_of_the_program_is_shown_and_ended_by_the_page(world) {
  const host = await recorded(world);
  const page = await world.viewer(host.addr);
  await settled(page);
  const program = recordByProgram(world, host.addr, 'program.mcap', 'host/sine/value');
  await page.locator('[data-recording="1"]').waitFor();
  await open(page);
  await page.locator('[data-recorder]', { hasText: 'of trocar record' }).waitFor();
  await eventually('messages come', async () => (await messages(page)) > 100);
  await shot(page, 'recording-of-the-program');
  await page.getByRole('button', { name: 'Stop', exact: true }).click();
  await page.locator('[data-recorder][data-phase=ENDED]').waitFor();
  is(await program.ended, 0, `how the program ends: ${program.printed}`);
  const read = await info(path.join(world.dir, 'program.mcap'));
  is([await messages(page), read.whole, read.reason], [read.messages, true, 'stopped as asked'], 'what the page tells, and what is in the file');
  is(await recorders(host.addr), [], 'recorders');
}

export async function a_recording_whose_time_is_over_while_no_page_looks_is_told_by_the_next_page(world) {
  const host = await recorded(world);
  const first = await world.viewer(host.addr);
  await settled(first);
  await open(first);
  await first.getByLabel('Seconds').fill('3');
  await begin_here(first);
  await first.close();
  const phase = async () => (await grpcurl(host.addr, 'InteractService/Invoke', { path: 'host/rec-viewer/ctl/last' })).json.reason;
  await eventually('its time is over', async () => (await phase()) === 'its time was over');
  is(await recorders(host.addr), ['host/rec-viewer'], 'recorders that have something to tell');
  const page = await world.viewer(host.addr);
  await page.locator('[data-recording="0"]', { hasText: '1 ended' }).waitFor();
  await open(page);
  const told = page.locator('[data-recorder][data-phase=ENDED]');
  const read = await info(await told.getAttribute('data-file'));
  is([await messages(page), read.reason], [read.messages, 'its time was over'], 'what the page tells, and what is in the file');
  holds(/^[\d.]+ k?B/.test(await figures(page)), `no duration is told that nobody saw: ${await figures(page)}`);
  await eventually('its recorder is taken away', async () => (await recorders(host.addr)).length === 0);
  // It stays until it was read.
  await page.reload();
  await open(page);
  await told.waitFor();
}

export async function a_page_that_only_reads_shows_recordings_and_changes_none(world) {
  const host = await recorded(world);
  const other = await world.viewer(host.addr);
  await settled(other);
  await begin(other, 'host/sine/value');
  const page = await world.viewer(host.addr, '?readonly');
  await page.locator('[data-recording="1"]').waitFor();
  await open(page);
  await eventually('messages come', async () => (await messages(page)) > 100);
  is(await panel(page).getByRole('button').allInnerTexts(), ['Close'], 'buttons');
  await shot(page, 'recording-readonly');
  await other.getByRole('button', { name: 'Stop', exact: true }).click();
  await page.locator('[data-recorder][data-phase=ENDED]', { hasText: 'nothing lost' }).waitFor();
}

export async function a_recording_whose_process_is_killed_says_so_and_its_file_has_what_came_before(world) {
  const each = { plugins: [PLUGINS], restart: { max: 3, backoff_ms: 50 } };
  const file = path.join(world.dir, 'one.json');
  fs.writeFileSync(file, JSON.stringify({ version: 1, processes: { only: each }, components: { 'only/sine': { class: 'sine' } }, connections: [] }));
  const { addr } = await world.start(['up', file, '--listen', '127.0.0.1:0', '--json'], 'up', { cwd: world.dir });
  const page = await world.viewer(addr);
  await settled(page);
  await begin(page, 'only/sine/value');
  await eventually('messages come', async () => (await messages(page)) > 500);
  const { pid } = (await grpcurl(addr, 'GcmService/List', { brief: true })).processes.find((p) => p.name === 'only');
  process.kill(pid, 'SIGKILL');
  const told = page.locator('[data-recorder][data-phase=ENDED]', { hasText: 'its process ended while it recorded' });
  await told.waitFor();
  await shot(page, 'recording-killed');
  const read = await info(await told.getAttribute('data-file'));
  holds(!read.whole && read.messages > 0, `what is in the file: ${JSON.stringify(read).slice(0, 300)}`);
  await eventually('its recorder is taken away', async () => (await recorders(addr)).length === 0);
}

export async function an_output_that_cannot_be_connected_is_left_out_and_named_and_the_rest_is_recorded(world) {
  const gcm = await world.gcm();
  await world.host('left', ['--gcm', gcm.addr], { cwd: world.dir });
  const right = await world.host('right', ['--gcm', gcm.addr]);
  for (const where of ['left', 'right']) await create(gcm.addr, 'sine', `${where}/sine`);
  await start(gcm.addr, 'left/sine', 'right/sine');
  const page = await world.viewer(gcm.addr);
  await settled(page);
  right.kill('SIGKILL');
  await page.locator('[data-process=right][data-standing=lost]').waitFor();
  await begin(page, '*/sine/value');
  const [one] = await page.locator('[data-recorder]').all();
  is(await one.getAttribute('data-recorder'), 'left/rec-viewer', 'where it is recorded');
  await one.getByText(/^not recorded: right\/sine\/value: process `right`/).waitFor();
  await eventually('messages come', async () => (await messages(page)) > 100);
  await shot(page, 'recording-left-out');
  // It is known for as long as its recording is shown.
  await page.reload();
  await open(page);
  await one.getByText(/^not recorded: right\/sine\/value: process `right`/).waitFor();
  await page.getByRole('button', { name: 'Stop', exact: true }).click();
  await page.locator('[data-recorder][data-phase=ENDED]').waitFor();
  await one.getByText(/^not recorded: right\/sine\/value: process `right`/).waitFor();
  is([await one.locator('.dot.warn').count(), await one.getByText('gave nothing').count()], [1, 0], 'a dot that warns, and outputs that gave nothing');
  holds((await figures(page)).includes('nothing lost of what was connected'), `what is said of losses: ${await figures(page)}`);
  await shot(page, 'recording-left-out-ended');
}

export async function outputs_left_out_of_a_start_that_was_refused_are_not_told_of_another_recording(world) {
  const gcm = await world.gcm();
  await world.host('left', ['--gcm', gcm.addr], { cwd: world.dir });
  const right = await world.host('right', ['--gcm', gcm.addr]);
  for (const where of ['left', 'right']) await create(gcm.addr, 'sine', `${where}/sine`);
  await start(gcm.addr, 'left/sine', 'right/sine');
  const [page, other] = [await world.viewer(gcm.addr), await world.viewer(gcm.addr)];
  right.kill('SIGKILL');
  await page.locator('[data-process=right][data-standing=lost]').waitFor();
  await open(page);
  await page.getByLabel('Patterns').fill('*/sine/value');
  await page.locator('[data-matched="2"]').waitFor();
  await page.getByLabel('File').fill('../out.mcap');
  await panel(page).getByRole('button', { name: 'Start' }).click();
  await panel(page).getByRole('alert').filter({ hasText: 'leads out of the directory' }).waitFor();
  await begin(other, 'left/sine/value');
  await page.locator('[data-recorder$="/rec-viewer"][data-phase=RECORDING]').waitFor();
  is(await page.getByText('not recorded:').count(), 0, 'outputs that are left out');
}

export async function a_component_that_does_not_tell_its_outputs_is_named_before_and_while_it_records(world) {
  const host = await recorded(world);
  const page = await world.viewer(host.addr);
  await settled(page);
  await refuse(page, 'Describe', 'host/echo', 4, 'it answered too late');
  await begin(page, '**');
  const unheard = 'host/echo did not report its outputs: it answered too late';
  is(await page.locator('[data-unheard]').allInnerTexts(), [unheard], 'what is said before');
  await page.locator('[data-recorder]').getByText(`not recorded: ${unheard}`).waitFor();
  await shot(page, 'recording-unheard');
  await page.getByLabel('Patterns').fill('host/sine/value');
  await page.locator('[data-unheard]').waitFor({ state: 'detached' });
}

export async function a_duration_or_rate_that_trocar_record_refuses_starts_nothing(world) {
  const host = await recorded(world);
  const page = await world.viewer(host.addr);
  await settled(page);
  await open(page);
  await page.locator('[data-matched]').waitFor();
  await page.getByText('Video, rate, process').click();
  const [seconds, rate] = [page.getByLabel('Seconds'), page.getByLabel('Samples per second of each output')];
  for (const [field, entered, why] of [[seconds, '0', 'above 0 and at most 86400'], [seconds, '86401', 'above 0'], [rate, '0', '0.0001 to 1000000'], [rate, '1000001', '0.0001']]) {
    await field.fill(entered);
    await panel(page).getByRole('button', { name: 'Start' }).click();
    await panel(page).getByRole('alert').filter({ hasText: `“${entered}” is not ${why}` }).waitFor();
    await field.fill('');
  }
  is(await recorders(host.addr), [], 'recorders');
}

export async function a_recorder_that_began_another_recording_while_nobody_looked_is_shown_with_its_new_file(world) {
  const host = await recorded(world);
  await recorderOf(host.addr, 'host/rec');
  const context = await world.browser();
  await context.clock.install();
  const page = await context.newPage();
  await page.goto(`http://${host.addr}/`);
  await settled(page);
  const elapsed = async () => (await command(host.addr, 'host/rec', 'status')).elapsed;
  // The end of the first one is not told any more, that of the second one is.
  const hides = async (...files) => {
    // By its beginning a recording is told from another one, to half a second.
    await eventually('it has recorded for a second', async () => (await elapsed()) > 1, elapsed);
    await seen(page, false);
    await page.clock.fastForward(LONG);
    const before = await elapsed();
    for (const file of files) {
      await command(host.addr, 'host/rec', 'stop');
      await eventually('it is closed', async () => (await command(host.addr, 'host/rec', 'path')) === '');
      await command(host.addr, 'host/rec', 'start', startOf(file));
    }
    await eventually('it has recorded for longer', async () => (await elapsed()) > before, elapsed);
    await seen(page, true);
  };
  await command(host.addr, 'host/rec', 'start', startOf('a.mcap'));
  await open(page);
  const one = (file, phase) => page.locator(`[data-file$="/${file}"][data-phase=${phase}]`);
  await one('a.mcap', 'RECORDING').waitFor();
  await hides('b.mcap');
  await one('b.mcap', 'RECORDING').waitFor();
  await one('a.mcap', 'ENDED').getByText('nothing lost').waitFor();
  await hides('c.mcap', 'd.mcap');
  await one('d.mcap', 'RECORDING').waitFor();
  await one('b.mcap', 'ENDED').getByText('It did not tell how it ended: another recording was begun since.').waitFor();
  await shot(page, 'recording-another');
  is(await recorders(host.addr), ['host/rec'], 'recorders');
}

export async function a_recorder_left_behind_that_records_by_now_is_not_taken_away(world) {
  const host = await recorded(world);
  await recorderOf(host.addr, 'host/rec-viewer');
  const page = await world.viewer(host.addr);
  await settled(page);
  await open(page);
  await page.locator('[data-idle="host/rec-viewer"]').waitFor();
  await shot(page, 'record-idle');
  // The page does not look any more, so the button stays.
  await page.evaluate(() => Object.defineProperty(document, 'hidden', { configurable: true, get: () => true }));
  await command(host.addr, 'host/rec-viewer', 'start', startOf('another.mcap'));
  await eventually('it records', async () => (await command(host.addr, 'host/rec-viewer', 'status')).phase === 'RECORDING');
  await page.getByRole('button', { name: 'Remove it' }).click();
  await panel(page).getByRole('alert').filter({ hasText: 'is not taken away' }).waitFor();
  is(await recorders(host.addr), ['host/rec-viewer'], 'recorders');
  // At rest it goes.
  await command(host.addr, 'host/rec-viewer', 'stop');
  await seen(page, true);
  await eventually('its recorder is taken away', async () => (await recorders(host.addr)).length === 0);
}

export async function a_recorder_that_does_not_answer_keeps_no_other_from_being_shown(world) {
  const host = await recorded(world);
  for (const name of ['first', 'second']) {
    await recorderOf(host.addr, `host/${name}`);
    await command(host.addr, `host/${name}`, 'start', startOf(`${name}.mcap`));
  }
  const page = await world.viewer(host.addr);
  await page.locator('[data-recording="2"]').waitFor();
  await open(page);
  await refuse(page, 'Invoke', 'host/first/ctl/', 14, 'connection refused');
  const one = (name) => page.locator(`[data-recorder="host/${name}"]`);
  await one('first').getByText('does not answer').waitFor();
  const time = () => one('second').locator('[data-figures]').innerText();
  const before = await time();
  await eventually('the other one goes on', async () => (await time()) !== before);
  is(await one('second').getByText('does not answer').count(), 0, 'what is said of the other one');
}

export async function the_top_of_a_narrow_window_has_room_for_a_recording_with_losses(world) {
  const gcm = await world.gcm();
  const left = await world.host('left', ['--gcm', gcm.addr]);
  await world.host('right', ['--gcm', gcm.addr], { cwd: world.dir });
  for (const where of ['left', 'right']) await create(gcm.addr, 'sine', `${where}/sine`);
  await start(gcm.addr, 'left/sine', 'right/sine');
  const page = await world.viewer(gcm.addr);
  await settled(page);
  // `right` records: it is the last one of equals.
  await begin(page, '*/sine/value');
  await page.keyboard.press('Escape');
  left.kill('SIGKILL');
  await eventually('it is interrupted', async () => (await record(page).innerText()).includes('1 interrupted'), () => record(page).innerText());
  await page.setViewportSize({ width: 300, height: 600 });
  const ends = () => page.locator('header.top > :is(button, .tools), .tools > button').evaluateAll((all) => all.map((e) => Math.round(e.getBoundingClientRect().right)));
  await eventually('all is inside the window', async () => (await ends()).every((x) => x <= 300), ends);
  holds(/^\d:\d\d$/.test((await record(page).innerText()).trim()), `what is in sight: ${await record(page).innerText()}`);
  holds(/\d:\d\d, .*B, 1 interrupted/.test(await record(page).getAttribute('aria-label')), 'what its label tells');
  await shot(page, 'recording-narrow');
}
