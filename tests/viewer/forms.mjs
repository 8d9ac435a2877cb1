/// What people do to components: menus, forms, the palette.
import { box, connect, create, eventually, grpcurl, holds, is, settled, shot, start, state } from './world.mjs';

async function menu(page, path, item) {
  await box(page, path).locator('header').click({ button: 'right' });
  await page.getByRole('menuitem', { name: new RegExp(`^${item}`) }).click();
}

export async function every_verb_of_the_menu_does_what_it_says(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  const page = await world.viewer(host.addr);
  await settled(page);
  await box(page, 'host/sine').locator('header').click({ button: 'right' });
  await page.getByRole('menuitem', { name: /^Start/ }).waitFor();
  await shot(page, 'context-menu');
  is(await page.getByRole('menuitem').evaluateAll((all) => all.map((e) => e.querySelector('span').innerText)), ['Start', 'Stop', 'Resume', 'Reset', 'Configure…', 'Show interfaces', 'Invoke…', 'Remove…'], 'the menu of a component without images and events');
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
  for (const [typed, why] of [['501', /500/], ['fast', /number|fast/i]]) {
    await field.fill(typed);
    await send.click();
    const said = await page.locator('[data-configure] .refusal').innerText();
    holds(why.test(said), `${typed}: ${said}`);
    await shot(page, typed === '501' ? 'configure-refused' : 'configure-wrong-type');
  }
  await field.fill('2.5');
  await send.click();
  await eventually('it is configured', async () => (await grpcurl(host.addr, 'GcmService/GetState', { path: 'host/sine' })).component.config.frequency_hz === 2.5);
}

export async function any_command_is_invoked_and_wrong_arguments_are_refused_in_the_servers_words(world) {
  const host = await world.host();
  await create(host.addr, 'echo', 'host/echo');
  await start(host.addr, 'host/echo');
  const page = await world.viewer(host.addr);
  await settled(page);
  await menu(page, 'host/echo', 'Invoke…');
  await page.getByLabel('Command').selectOption('ctl/write');
  const argument = page.locator('#argument');
  const outcome = page.locator('[data-outcome]');
  for (const wrong of ['"text"', '{"a": 1}', '[1', 'many']) {
    await argument.fill(wrong);
    await page.getByRole('button', { name: 'Invoke' }).click();
    await page.locator('[data-outcome].refusal').waitFor();
    holds((await outcome.innerText()).length > 12, `${wrong} is refused in a sentence: ${await outcome.innerText()}`);
  }
  await shot(page, 'invoke-refused');
  await argument.fill('12.5');
  await page.getByRole('button', { name: 'Invoke' }).click();
  await page.locator('[data-outcome]:not(.refusal)').waitFor();
  await eventually('it was written', async () => (await grpcurl(host.addr, 'InteractService/Read', { path: 'host/echo' })).json.value === 12.5);
  await shot(page, 'invoke');
}

export async function what_is_out_of_a_commands_range_is_refused_with_the_range(world) {
  const host = await world.host();
  await create(host.addr, 'example/Server', 'host/Server');
  await start(host.addr, 'host/Server');
  const page = await world.viewer(host.addr);
  await settled(page);
  await menu(page, 'host/Server', 'Invoke…');
  await page.getByLabel('Command').selectOption('Provided/Write');
  for (const [wrong, why] of [['300', /300 is above maximum 100 mm/], ['-1', /-1 is below minimum 0 mm/]]) {
    await page.locator('#argument').fill(wrong);
    await page.getByRole('button', { name: 'Invoke' }).click();
    await page.locator('[data-outcome].refusal', { hasText: why }).waitFor();
  }
  await shot(page, 'invoke-out-of-range');
}

export async function a_class_is_dragged_from_the_palette_into_a_process(world) {
  const host = await world.host();
  const page = await world.viewer(host.addr);
  await page.locator('[data-process=host]').waitFor();
  await page.getByRole('button', { name: 'Palette' }).click();
  await page.getByLabel('filter classes').fill('sine');
  const from = await page.locator('[data-class="sine/sine"]').boundingBox();
  const to = await page.locator('[data-process=host]').boundingBox();
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
  const small = await page.locator('button:visible, select:visible').evaluateAll((all) =>
    all.map((e) => [e.getAttribute('aria-label') || e.innerText, e.getBoundingClientRect()]).filter(([, b]) => b.height < 43.5 || b.width < 43.5).map(([t, b]) => `${t}: ${b.width} × ${b.height}`),
  );
  is(small, [], 'buttons smaller than a finger');
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
  for (const verb of ['Start', 'Invoke…', 'Remove…']) is(await page.getByRole('menuitem', { name: verb }).getAttribute('aria-disabled'), 'true', verb);
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
  const path = text(1, 'host/sine');
  const changes = ['Create', 'Remove', 'Configure', 'Start', 'Stop', 'Resume', 'Reset', 'Connect', 'Disconnect', 'Apply', 'Replace', 'Move'].map((m) => `GcmService/${m}`);
  for (const method of [...changes, 'InteractService/Emit', 'PluginService/Load', 'PluginService/Unload', 'PluginService/Reload', 'GuestService/Join', 'GuestService/Require', 'AttachService/Tell', 'AttachService/Attach']) {
    const { status, said } = await asked(page, method, path);
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
  for (const method of ['GcmService/List', 'GcmService/GetState', 'GcmService/Describe', 'InteractService/Read']) is((await asked(page, method, path)).status, '0', method);
  // Programs go on as ever.
  await grpcurl(host.addr, 'GcmService/Stop', { path: 'host/sine' });
  await box(page, 'host/sine').locator('[data-state]', { hasText: 'STOPPED' }).waitFor();
}
