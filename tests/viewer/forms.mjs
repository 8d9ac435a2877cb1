/// What people do to components: menus, forms, the palette.
import { box, connect, create, eventually, grpcurl, holds, is, menu, reveal, settled, shot, start, state, still } from './world.mjs';

export async function every_verb_of_the_menu_does_what_it_says(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  const page = await world.viewer(host.addr);
  await settled(page);
  await box(page, 'host/sine').locator('header').click({ button: 'right' });
  await page.getByRole('menuitem', { name: /^Start/ }).waitFor();
  await shot(page, 'context-menu');
  is(await page.getByRole('menuitem').evaluateAll((all) => all.map((e) => e.querySelector('span').innerText)), ['Start', 'Stop', 'Resume', 'Reset', 'Configure…', 'Show interfaces', 'Invoke…', 'Connect to…', 'Remove…'], 'the menu of a component without images and events');
  holds((await page.getByRole('menuitem', { name: /^Resume/ }).getAttribute('aria-disabled')) === 'true', 'what its state does not allow is greyed');
  await page.keyboard.press('Escape');
  for (const [verb, becomes] of [['Start', 'ACTIVE'], ['Stop', 'STOPPED'], ['Resume', 'ACTIVE'], ['Stop', 'STOPPED'], ['Reset', 'READY']]) {
    await menu(page, 'host/sine', verb);
    await eventually(`${verb} leads to ${becomes}`, async () => (await state(host.addr, 'host/sine')) === becomes);
    await box(page, 'host/sine').locator('[data-state]', { hasText: becomes }).waitFor();
  }
  await menu(page, 'host/sine', 'Show interfaces');
  await page.locator('[data-interface=signal]').waitFor();
  await shot(page, 'interfaces');
  await menu(page, 'host/sine', 'Remove…');
  await page.getByText('This would be done:').waitFor();
  await shot(page, 'remove');
  await page.getByRole('button', { name: 'Remove', exact: true }).click();
  await box(page, 'host/sine').waitFor({ state: 'detached' });
  is((await grpcurl(host.addr, 'GcmService/List')).components ?? [], [], 'components');
}

export async function a_configuration_is_a_form_and_what_is_refused_says_why(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  await start(host.addr, 'host/sine');
  const page = await world.viewer(host.addr);
  await settled(page);
  await menu(page, 'host/sine', 'Configure…');
  const field = page.getByLabel(/^frequency_hz/);
  is(await field.inputValue(), '1', 'what is configured now');
  holds((await page.locator('[data-configure]').innerText()).includes('Hz'), 'units are shown');
  const send = page.getByRole('button', { name: 'Configure', exact: true });
  for (const [typed, at, why] of [['501', '501 is above 500 Hz', /500/], ['fast', 'fast is not a number', /number|fast/i]]) {
    await field.fill(typed);
    is(await page.locator('[data-wrong="field/frequency_hz"]').innerText(), at, 'at the field');
    await send.click();
    // What was said before stays until the next answer.
    await page.locator('[data-configure] .refusal', { hasText: why }).waitFor();
    await shot(page, typed === '501' ? 'configure-refused' : 'configure-wrong-type');
  }
  await field.fill('2.5');
  await send.click();
  await eventually('it is configured', async () => (await grpcurl(host.addr, 'GcmService/GetState', { path: 'host/sine' })).component.config.frequency_hz === 2.5);
}

export async function how_it_runs_is_chosen_among_what_its_class_is_made_for(world) {
  const host = await world.host();
  const page = await world.viewer(host.addr);
  const executionOf = async (p) => (await grpcurl(host.addr, 'GcmService/GetState', { path: p })).component.execution;
  await page.getByRole('button', { name: 'Palette' }).click();
  await page.locator('[data-class="eyerobot/eyerobot"]').click();
  const form = page.locator('[data-create]');
  const part = form.locator('[data-part=execution]');
  const limits = (await grpcurl(host.addr, 'GcmService/Describe', { class: 'eyerobot/eyerobot' })).class.executionLimits;
  const hz = (period) => 1 / Number(period.slice(0, -1));
  const [slowest, fastest] = [limits.maxPeriod, limits.minPeriod].map(hz);
  is(await part.locator('summary small').innerText(), `${limits.models.join(', ')}, ${slowest} … ${fastest} Hz`, 'what it is made for');
  await part.locator('summary').click();
  const model = part.getByLabel('model', { exact: true });
  is(await model.locator('option').allInnerTexts(), limits.models, 'what may be chosen');
  is(await model.locator('option:checked').innerText(), 'periodic', 'what it is without a change');
  const rate = part.getByLabel('rate_hz', { exact: true });
  await rate.fill('3');
  is(await part.locator('[data-wrong="run/rate_hz"]').innerText(), `3 is below ${slowest} Hz`, 'at the field');
  // Refused in the server's words; the form stays as it is.
  const make = page.getByRole('button', { name: 'Create', exact: true });
  await make.click();
  await form.locator('.refusal', { hasText: `${slowest}` }).waitFor();
  is((await grpcurl(host.addr, 'GcmService/List', {})).components ?? [], [], 'components');
  await rate.fill('500');
  await make.click();
  await form.waitFor({ state: 'detached' });
  const runs = async () => { const e = await executionOf('host/eyerobot'); return [e.model, e.period ? hz(e.period) : e.rateHz]; };
  is(await runs(), ['periodic', 500], 'how it runs');

  await menu(page, 'host/eyerobot', 'Configure…');
  const present = page.locator('[data-configure="host/eyerobot"] [data-part=execution]');
  await present.locator('summary').click();
  is(await present.getByLabel('rate_hz', { exact: true }).inputValue(), '500', 'how it runs now');
  await present.getByLabel('rate_hz', { exact: true }).fill('2000');
  await page.getByRole('button', { name: 'Configure', exact: true }).click();
  await eventually('it runs so', async () => (await runs())[1] === 2000);
  holds(await page.getByRole('button', { name: 'Configure', exact: true }).isDisabled(), 'there is nothing more to send');
}

const configOf = async (addr, p) => (await grpcurl(addr, 'GcmService/GetState', { path: p })).component.config;

export async function of_a_large_form_only_what_was_changed_is_sent(world) {
  const host = await world.host();
  await create(host.addr, 'recorder/recorder', 'host/log', { directory: world.dir, topics: ['a', 'b'], every: [2, 3], jpeg_quality: 70 });
  const page = await world.viewer(host.addr);
  await settled(page);
  await menu(page, 'host/log', 'Configure…');
  const form = page.locator('[data-configure="host/log"]');
  const field = (name) => form.getByLabel(name, { exact: true });
  const send = page.getByRole('button', { name: 'Configure', exact: true });
  const video = field('video');
  is(await video.locator('option').allInnerTexts(), ['raw', 'qoi', 'jpeg'], 'what may be chosen');
  const rows = (list) => form.locator(`[id^="field/${list}/"]:is(input)`).evaluateAll((all) => all.map((e) => e.value));
  const add = async (list, ...typed) => {
    for (const value of typed) {
      await form.getByRole('button', { name: `add to ${list}`, exact: true }).click();
      await field(`${list}[${(await rows(list)).length - 1}]`).fill(value);
    }
  };
  is([await rows('topics'), await rows('every')], [['a', 'b'], ['2', '3']], 'an array is a field for each');
  holds(/1 … 100/.test(await form.locator('.field', { has: page.locator('label', { hasText: 'jpeg_quality' }) }).innerText()), 'a range is shown');
  holds(await send.isDisabled(), 'where nothing was changed there is nothing to send');
  let before = await configOf(host.addr, 'host/log');
  const same = async (why) => is(await configOf(host.addr, 'host/log'), before, why);
  const note = (words) => page.locator('[data-note]', { hasText: words });

  await video.selectOption({ label: 'qoi' });
  await page.getByRole('button', { name: 'Check only' }).click();
  await note('would be done: ').filter({ hasText: 'host/log' }).waitFor();
  await same('a check');
  await shot(page, 'configure-checked');
  await send.click();
  await note('Configure host/log: done').waitFor();
  before = { ...before, video: 'qoi' };
  await same('only what was changed');

  // What somebody else sets meanwhile is neither shown as it was, nor sent back.
  await grpcurl(host.addr, 'GcmService/Configure', { path: 'host/log', config: { pre_trigger_mb: 64 } });
  await form.getByRole('button', { name: 'remove every[0]' }).click();
  await field('every[0]').fill('4');
  await eventually('what somebody else has set is shown', async () => (await field('pre_trigger_mb').inputValue()) === '64');
  is(await rows('every'), ['4'], 'what was typed stays');
  await send.click();
  before = { ...before, pre_trigger_mb: 64, every: [4] };
  await eventually('it is configured', async () => (await configOf(host.addr, 'host/log')).every.length === 1);
  await same('only what was changed, beside somebody else');

  // Refused in the server's words.
  for (const [name, typed, why] of [['jpeg_quality', '101', /jpeg_quality.*100/], ['every[0]', '0', /every\[0\].*keeps nothing/]]) {
    const had = await field(name).inputValue();
    await field(name).fill(typed);
    await send.click();
    await form.locator('.refusal', { hasText: why }).waitFor();
    await same(`${name} ${typed}`);
    await field(name).fill(had);
  }
  await add('max_rate_hz', '1', '2', '3');
  await send.click();
  await form.locator('.refusal', { hasText: /max_rate_hz: 3 items for 2 topics/ }).waitFor();
  await same('too many rates');
  for (let n = 0; n < 3; n += 1) await form.getByRole('button', { name: 'remove max_rate_hz[0]' }).click();

  // Refused here: nobody could say what was meant, so nothing else of the form goes, either.
  await video.selectOption({ label: 'jpeg' });
  await form.getByRole('button', { name: 'topics as JSON' }).click();
  is(await field('topics').inputValue(), '["a","b"]', 'an array as JSON');
  await field('topics').fill('["a", "b"');
  const said = form.locator('[data-wrong="field/topics"]');
  holds(/^not valid JSON: /.test(await said.innerText()), `a sentence: ${await said.innerText()}`);
  await send.click();
  await page.getByRole('button', { name: 'Check only' }).click();
  await form.locator('.refusal', { hasText: 'topics' }).waitFor();
  await shot(page, 'configure-no-json');
  await same('no JSON');
  await field('topics').fill('{"a": 1}');
  await send.click();
  await form.locator('.refusal', { hasText: 'topics' }).waitFor();
  await same('no list');
  await page.getByRole('button', { name: 'Revert' }).click();
  is([await rows('topics'), await video.inputValue(), await said.count()], [['a', 'b'], '"qoi"', 0], 'everything is as it was');

  await field('topics[0]').fill('left');
  await field('topics[1]').fill('right');
  await add('topics', 'third');
  await shot(page, 'configure-rows');
  await send.click();
  await page.locator('[data-port="host/log/third"]').waitFor();
  before = { ...before, topics: ['left', 'right', 'third'] };
  await same('an array');
}

export async function many_numbers_share_a_field_with_commas_between_them(world) {
  const host = await world.host();
  const numbers = Array.from({ length: 20 }, (_, n) => n + 1);
  await create(host.addr, 'recorder/recorder', 'host/log', { directory: world.dir, topics: numbers.map((n) => `t${n}`), every: numbers });
  const page = await world.viewer(host.addr);
  await settled(page);
  await menu(page, 'host/log', 'Configure…');
  const form = page.locator('[data-configure="host/log"]');
  const field = form.getByLabel('every', { exact: true });
  is(await field.inputValue(), numbers.join(', '), 'what is configured');
  is(await form.locator('[id^="field/topics/"]:is(input)').count(), 20, 'texts have a field each');
  const wrong = form.locator('[data-wrong="field/every"]');
  for (const [typed, why] of [['far', 'number 19: far is not a number'], ['-1', 'number 19: -1 is below 0'], ['0.5', 'number 19: 0.5 is not a whole number']]) {
    await field.fill(`${numbers.slice(1).join(',')}, ${typed}`);
    is(await wrong.innerText(), why, 'at the field');
  }
  const wanted = [...numbers.slice(1), 1000];
  await field.fill(wanted.join(' , '));
  await shot(page, 'configure-many-numbers');
  await page.getByRole('button', { name: 'Configure', exact: true }).click();
  await eventually('it is configured', async () => JSON.stringify((await configOf(host.addr, 'host/log')).every) === JSON.stringify(wanted));
}

export async function a_class_is_dragged_from_the_palette_into_a_process(world) {
  const host = await world.host();
  const page = await world.viewer(host.addr);
  await page.locator('[data-process=host]').waitFor();
  await page.getByRole('button', { name: 'Palette' }).click();
  await page.getByLabel('filter classes').fill('sine');
  await eventually('it is there alone', async () => (await page.locator('[data-class]').count()) === 1);
  const from = await still(page.locator('[data-class="sine/sine"]'));
  const to = await still(page.locator('[data-process=host]'));
  await page.mouse.move(from.x + 30, from.y + 12);
  await page.mouse.down();
  await page.mouse.move(to.x + to.width / 2, to.y + to.height / 2, { steps: 8 });
  await shot(page, 'palette');
  await page.mouse.up();
  await page.locator('[data-create]').waitFor();
  await page.getByLabel('Name').fill('made/wrong');
  await page.getByRole('button', { name: 'Create', exact: true }).click();
  await page.locator('[data-create] .refusal').waitFor();
  await shot(page, 'create-refused');
  await page.getByLabel('Name').fill('made');
  await page.getByRole('button', { name: 'Create', exact: true }).click();
  await box(page, 'host/made').waitFor();
  is(await state(host.addr, 'host/made'), 'READY', 'state');
}

/// What can be touched and is smaller than a finger. Ports and lines stand too close for that; see docs/VIEWER.md.
const small = (page) =>
  page.locator('button:visible, select:visible, input:visible, textarea:visible, summary:visible, a:visible, [role=option]:visible').evaluateAll((all) =>
    all.map((e) => [e, e.getBoundingClientRect()]).filter(([, b]) => b.height < 43.5 || b.width < 43.5).map(([e, b]) => `${e.tagName} ${e.getAttribute('aria-label') || e.innerText || e.id}: ${b.width} × ${b.height}`),
  );

export async function what_is_touched_is_as_large_as_a_finger_in_every_view(world) {
  const host = await world.host();
  for (const [cls, p] of [['sine', 'host/sine'], ['echo', 'host/echo'], ['example/Client', 'host/client'], ['example/Server', 'host/Server'], ['eyerobot/eyerobot', 'host/robot']]) await create(host.addr, cls, p);
  await connect(host.addr, 'host/echo/sample', 'host/sine/value');
  await start(host.addr, 'host/sine', 'host/echo');
  const page = await world.viewer(host.addr, '', { hasTouch: true, isMobile: true, viewport: { width: 1024, height: 768 } });
  await settled(page);
  const found = [];
  const look = async (view, least) => {
    const looked = await page.locator('button:visible, select:visible, input:visible, textarea:visible, summary:visible, a:visible').count();
    holds(looked >= least, `${view}: only ${looked} things to touch were found`);
    for (const one of await small(page)) if (!found.some((f) => f.endsWith(one))) found.push(`${view}: ${one}`);
  };
  const tab = (name) => page.getByRole('tab', { name }).tap();
  const select = async (p) => {
    await reveal(page, p);
    await page.locator('.inspector strong', { hasText: p }).waitFor();
  };
  await look('graph', 10);
  await page.getByRole('button', { name: 'Palette' }).tap();
  await page.locator('[data-class="sine/sine"]').waitFor();
  await look('palette', 20);
  await page.locator('[data-class="recorder/recorder"]').tap();
  await page.locator('[data-create] [data-part=configuration] summary').waitFor();
  await page.locator('[data-create] [data-part=configuration]').evaluate((e) => { e.open = true; });
  await look('create', 20);
  await page.getByRole('button', { name: 'Cancel' }).tap();
  await page.getByRole('button', { name: 'Palette' }).tap();
  // A check box, an array and numbers; events and reads; a connection.
  await select('host/client');
  await tab('Configure');
  await page.locator('[data-configure="host/client"] input[type=checkbox]').waitFor();
  await look('Configure', 15);
  await select('host/sine');
  await tab('Overview');
  await page.locator('.inspector button', { hasText: 'host/echo/sample' }).waitFor();
  await look('Overview', 15);
  await select('host/Server');
  await tab('Invoke');
  await page.getByLabel('Command').selectOption('Provided/Write');
  await page.locator('#argument').waitFor();
  await look('Invoke', 15);
  await select('host/robot');
  await tab('Invoke');
  await page.getByLabel('Command').selectOption('arm/move_jp');
  await page.getByRole('button', { name: 'add to position' }).tap();
  await page.getByRole('button', { name: 'effort as JSON' }).tap();
  await look('Invoke of a structure', 20);
  await shot(page, 'touch-invoke');
  await select('host/Server');
  await tab('Interfaces');
  await page.locator('[data-plot="host/Server#set_point"]').waitFor({ state: 'attached' });
  await page.locator('.inspector details').evaluateAll((all) => all.forEach((e) => { e.open = true; }));
  await look('Interfaces', 20);
  await shot(page, 'touch-interfaces');
  await page.locator('[data-plot="host/Server#set_point"]').tap();
  await page.locator('[data-curve]').waitFor();
  await page.getByLabel('A number that is chosen goes into').selectOption('1');
  await page.locator('[data-plot="host/Server/Provided/Read#"]').tap();
  await page.getByRole('button', { name: 'Settings', exact: true }).tap();
  await page.getByLabel('settings of another component').selectOption('host/sine');
  await page.locator('[data-tuning="host/sine"] [type=range]').waitFor();
  await look('Plots', 20);
  await shot(page, 'touch-plots');
  await page.locator('[data-follow="host/Server/Provided/SetPointReached"]').tap();
  await page.getByRole('button', { name: /^follow .* no more$/ }).waitFor();
  await look('Events', 20);
  await page.getByRole('button', { name: /^Search/ }).tap();
  await page.locator('#found li').first().waitFor();
  await look('search', 10);
  is(found, [], 'what is smaller than a finger');
}

export async function fingers_open_the_menu_by_a_long_press_and_find_what_they_touch(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  const page = await world.viewer(host.addr, '', { hasTouch: true, isMobile: true, viewport: { width: 1024, height: 768 } });
  await settled(page);
  const at = await box(page, 'host/sine').locator('header').boundingBox();
  const fingers = await page.context().newCDPSession(page);
  const point = { x: at.x + at.width / 2, y: at.y + at.height / 2 };
  await fingers.send('Input.dispatchTouchEvent', { type: 'touchStart', touchPoints: [point] });
  await page.getByRole('menuitem', { name: /^Start/ }).waitFor();
  await fingers.send('Input.dispatchTouchEvent', { type: 'touchEnd', touchPoints: [] });
  await shot(page, 'touch');
  is(await small(page), [], 'what is smaller than a finger');
  await page.getByRole('menuitem', { name: /^Connect to/ }).tap();
  await page.locator('[data-connect="host/sine"]').waitFor();
  is(await small(page), [], 'what is smaller than a finger, of what may be connected');
  await shot(page, 'touch-connect');
  await page.getByRole('button', { name: 'Cancel' }).tap();
  await fingers.send('Input.dispatchTouchEvent', { type: 'touchStart', touchPoints: [point] });
  await page.getByRole('menuitem', { name: /^Start/ }).waitFor();
  await fingers.send('Input.dispatchTouchEvent', { type: 'touchEnd', touchPoints: [] });
  await page.getByRole('menuitem', { name: /^Start/ }).tap();
  await eventually('it runs', async () => (await state(host.addr, 'host/sine')) === 'ACTIVE');
}

export async function a_page_that_only_reads_offers_no_way_to_change_anything(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  const page = await world.viewer(host.addr, '?readonly');
  await settled(page);
  await page.getByText('read-only').waitFor();
  is(await page.getByRole('button', { name: 'Palette' }).count(), 0, 'palettes');
  await box(page, 'host/sine').locator('header').click({ button: 'right' });
  for (const verb of ['Start', 'Invoke…', 'Connect to…', 'Remove…']) is(await page.getByRole('menuitem', { name: verb }).getAttribute('aria-disabled'), 'true', verb);
  await shot(page, 'read-only');
  await page.getByRole('menuitem', { name: 'Show configuration' }).click();
  await page.locator('[data-configure]').waitFor();
  is(await page.getByRole('button', { name: 'Configure', exact: true }).count(), 0, 'ways to configure');
}

/// One gRPC-Web call as a page would make it, past what its buttons allow: the status and the sentence.
const asked = (page, method, message) =>
  page.evaluate(async ([method, message]) => {
    const body = new Uint8Array([0, 0, 0, 0, message.length, ...message]);
    const headers = { 'content-type': 'application/grpc-web+proto', 'x-grpc-web': '1' };
    const answer = await fetch(`/trocar.v1.${method}`, { method: 'POST', body, headers });
    const text = new TextDecoder('latin1').decode(new Uint8Array(await answer.arrayBuffer()));
    const of = (name) => answer.headers.get(name) ?? new RegExp(`${name}: ?([^\\r\\n]*)`).exec(text)?.[1] ?? '';
    return { status: of('grpc-status'), said: decodeURIComponent(of('grpc-message')) };
  }, [method, message]);
/// A field of text: its number, its length, its letters.
const text = (field, value) => [field << 3 | 2, value.length, ...new TextEncoder().encode(value)];

export async function a_program_whose_viewer_only_reads_tells_its_page_and_refuses_it_what_changes_something(world) {
  const host = await world.host('host', ['--viewer-read-only']);
  await create(host.addr, 'sine', 'host/sine');
  await create(host.addr, 'echo', 'host/echo');
  await connect(host.addr, 'host/echo/sample', 'host/sine/value');
  await start(host.addr, 'host/**');
  const page = await world.viewer(host.addr);
  await settled(page);
  await page.getByText('read-only').waitFor();
  is(await page.getByRole('button', { name: 'Palette' }).count(), 0, 'palettes');
  await box(page, 'host/sine').locator('header').click({ button: 'right' });
  is(await page.getByRole('menuitem', { name: /^Stop/ }).getAttribute('aria-disabled'), 'true', 'Stop');
  await shot(page, 'read-only-by-the-server');
  await page.keyboard.press('Escape');
  // Whoever writes to the port from the page's own console gets no further.
  const sine = text(1, 'host/sine');
  const changes = ['Create', 'Remove', 'Configure', 'Start', 'Stop', 'Resume', 'Reset', 'Connect', 'Disconnect', 'Apply', 'Replace', 'Move'].map((m) => `GcmService/${m}`);
  for (const method of [...changes, 'InteractService/Emit', 'PluginService/Load', 'PluginService/Unload', 'PluginService/Reload', 'GuestService/Join', 'GuestService/Require', 'AttachService/Tell', 'AttachService/Attach']) {
    const { status, said } = await asked(page, method, sine);
    is(status, '7', `${method} is refused: ${said}`);
    holds(said.includes('this viewer only reads') && said.includes(method.split('/')[1]), `${method} says why: ${said}`);
  }
  is(await state(host.addr, 'host/sine'), 'ACTIVE', 'state');
  // Commands that read may be called, those that change something may not, also not while an event is waited for.
  is(await asked(page, 'InteractService/Invoke', text(1, 'host/sine/signal/value')), { status: '0', said: '' }, 'a read command');
  const write = await asked(page, 'InteractService/Invoke', text(1, 'host/echo/ctl/write'));
  is(write.status, '7', `a write command: ${write.said}`);
  holds(write.said.includes('host/echo/ctl/write') && write.said.includes('only reads'), write.said);
  const call = text(1, 'host/echo/ctl/write');
  is((await asked(page, 'GcmService/WaitFor', [...text(1, 'host/echo/ctl/written'), (4 << 3) | 2, call.length, ...call])).status, '7', 'a write command beside WaitFor');
  is((await asked(page, 'InteractService/Invoke', text(1, 'host/sine/signal/nothing'))).status, '5', 'a command that is not there');
  for (const method of ['GcmService/List', 'GcmService/GetState', 'GcmService/Describe', 'InteractService/Read']) is((await asked(page, method, sine)).status, '0', method);
  // Programs go on as ever.
  await grpcurl(host.addr, 'GcmService/Stop', { path: 'host/sine' });
  await box(page, 'host/sine').locator('[data-state]', { hasText: 'STOPPED' }).waitFor();
}

export async function whole_numbers_of_64_bits_are_shown_and_sent_to_the_last_digit(world) {
  const host = await world.host();
  const [exact, signed, several] = ['9007199254740993', '-9007199254740993', '18446744073709551615'];
  await create(host.addr, 'echo', 'host/echo', { exact, signed, several: [several] });
  await start(host.addr, 'host/echo');
  const has = async (member) => (await grpcurl(host.addr, 'InteractService/Invoke', { path: `host/echo/ctl/${member}` })).json;
  const page = await world.viewer(host.addr);
  await settled(page);
  await menu(page, 'host/echo', 'Configure…');
  const form = page.locator('[data-configure]');
  const field = (name) => form.getByLabel(new RegExp(`^${name}`));
  is([await field('exact').inputValue(), await field('signed').inputValue()], [exact, signed], 'what is configured now');
  is(await form.locator('[data-wrong]').allInnerTexts().then((all) => all.filter(Boolean)), [], 'nothing is wrong with it');
  // The next numbers there are: each is another one as a double.
  await field('exact').fill('9007199254740995');
  await field('signed').fill('-9007199254740995');
  is(await form.locator('[data-wrong]').allInnerTexts().then((all) => all.filter(Boolean)), [], 'nor with what was typed');
  await page.getByRole('button', { name: 'Configure', exact: true }).click();
  await eventually('it is configured', async () => (await has('exact')) === '9007199254740995', () => has('exact'));
  is([await has('signed'), await has('first_of_several')], ['-9007199254740995', several], 'what the component has');
  const config = (await grpcurl(host.addr, 'GcmService/GetState', { path: 'host/echo' })).component.config;
  is([config.exact, config.signed, config.several], ['9007199254740995', '-9007199254740995', [several]], 'what it is configured with');
  // Opened anew it shows what was sent.
  await page.keyboard.press('Escape');
  await menu(page, 'host/echo', 'Configure…');
  is([await field('exact').inputValue(), await field('signed').inputValue()], ['9007199254740995', '-9007199254740995'], 'shown');
}
