/// Commands that are invoked: fields out of their types, JSON instead, refusals.
import fs from 'node:fs';
import path from 'node:path';
import { create, eventually, grpcurl, holds, is, menu, settled, shot, start } from './world.mjs';

/// A host with a component of the class that runs, and a page with the form of this command.
async function formOf(world, cls, p, command, config) {
  const host = await world.host();
  await create(host.addr, cls, p, config);
  await start(host.addr, p);
  const page = await world.viewer(host.addr);
  await settled(page);
  await menu(page, p, 'Invoke…');
  await page.getByLabel('Command').selectOption(command);
  const form = page.locator(`[data-invoke="${p}"]`);
  return {
    host,
    page,
    form,
    /// What is entered at this name: position[0].
    entry: (name) => form.getByLabel(name, { exact: true }),
    /// What is said to be wrong there.
    wrong: (id) => form.locator(`[data-wrong="${id}"]`),
    add: (name) => form.getByRole('button', { name: `add to ${name}`, exact: true }),
    invoke: () => page.getByRole('button', { name: 'Invoke' }).click(),
    done: page.locator('[data-outcome]:not(.refusal)'),
    refused: page.locator('[data-outcome].refusal'),
  };
}

export async function a_robot_is_moved_by_fields_with_units_and_a_wrong_number_is_refused_at_its_field(world) {
  const { host, page, form, entry, wrong, add, invoke, done, refused } = await formOf(world, 'eyerobot/eyerobot', 'host/robot', 'arm/move_jp', { auto_enable: true });
  const position = form.locator('fieldset', { has: page.locator('legend:text-is("position")') }).last();
  holds((await position.innerText()).includes('At most 16'), `how many there may be: ${await position.innerText()}`);
  for (let i = 0; i < 5; i += 1) await add('position').click();
  is(await position.locator('.unit').allInnerTexts(), Array(5).fill('m|rad'), 'units');
  holds(await entry('position[4]').evaluate((e) => e === document.activeElement), 'what was added is what is typed into');
  is(await entry('stamp').inputValue(), '', 'a stamp is shown, and may stay empty');
  const stands = async () => (await grpcurl(host.addr, 'InteractService/Invoke', { path: 'host/robot/arm/setpoint_js' })).json.position;
  const before = await stands();
  for (const [typed, at, server] of [['far', /far is not a number/, /position.0.*far/], ['', /a number is missing/, /position.0/]]) {
    await entry('position[0]').fill(typed);
    await wrong('argument/position/0').filter({ hasText: at }).waitFor();
    is(await entry('position[0]').getAttribute('aria-invalid'), 'true', 'who hears the page is told');
    await invoke();
    await refused.filter({ hasText: server }).waitFor();
    is(await stands(), before, 'nothing moves');
  }
  await shot(page, 'invoke-robot-refused');
  // As it is typed by hand: what "-", "-0" and "-0.00" mean alone does not take it away.
  await entry('position[0]').press('Control+a');
  await entry('position[0]').pressSequentially('-0.004');
  is(await entry('position[0]').inputValue(), '-0.004', 'what was typed');
  await entry('position[2]').fill('1e-3');
  is(await form.locator('[data-wrong]').count(), 0, 'what is wrong');
  await invoke();
  await done.waitFor();
  await eventually('it goes there', async () => (await stands()).every((v, i) => Math.abs(v - [-0.004, 0, 0.001, 0, 0][i]) < 1e-9));
  await shot(page, 'invoke-robot');
}

/// Of each kind of type one, as `mirror` of the test plugin answers it.
const ALL = {
  array: [0, 0, 7, 0],
  level: -300,
  list: [1.5, 'NaN'],
  mood: 'BUSY',
  on: true,
  order: { arg: -0.5, deadline_ns: '18446744073709551615', how: 2, threads: 3, times: 4, what: 1 },
  stamp: 0,
  text: 'ü; "quoted"',
  tiny: -128,
};
const inOrder = (value) => (value && typeof value === 'object' && !Array.isArray(value) ? Object.fromEntries(Object.keys(value).sort().map((k) => [k, inOrder(value[k])])) : value);

export async function every_kind_of_value_is_entered_in_fields_and_arrives_as_it_was_typed(world) {
  const { page, form, entry, wrong, add, invoke, done, refused } = await formOf(world, 'fixture-conform/Server', 'host/s', 'ctl/mirror');
  for (const [name, typed] of Object.entries(ALL.order)) await entry(name).fill(String(typed));
  for (const i of [0, 1]) {
    await add('list').click();
    await entry(`list[${i}]`).fill(String(ALL.list[i]));
  }
  await entry('text').fill(ALL.text);
  await entry('array[2]').fill('7');
  await entry('mood').selectOption('BUSY');
  await entry('level').fill('-300');
  await entry('on').check();
  for (const [typed, why] of [['-129', '-129 is below -128'], ['1.5', '1.5 is not a whole number']]) {
    await entry('tiny').fill(typed);
    is(await wrong('argument/tiny').innerText(), why, 'at the field');
    await invoke();
    await refused.filter({ hasText: /tiny/ }).waitFor();
  }
  await shot(page, 'invoke-all-refused');
  await entry('tiny').fill('-128');
  const mirrored = async () => {
    await invoke();
    await done.waitFor();
    return JSON.parse(await done.innerText());
  };
  is(await mirrored(), ALL, 'what came back');
  await shot(page, 'invoke-all');

  // As JSON it is the same, and what is changed there is in the fields.
  const json = form.getByRole('button', { name: 'all as JSON', exact: true });
  await json.click();
  holds(await json.evaluate((e) => e === document.activeElement), 'the keyboard stays where it was');
  const { stamp, ...typed } = ALL;
  const text = page.locator('#argument');
  is(inOrder(JSON.parse(await text.inputValue())), typed, `what was typed, as JSON; the stamp of ${stamp} is left out`);
  await text.fill('{"order": ');
  is(await json.isDisabled(), true, 'back from what is no JSON');
  await invoke();
  await refused.filter({ hasText: /not valid JSON.*nothing was sent/ }).waitFor();
  await shot(page, 'invoke-no-json');
  await text.fill(JSON.stringify({ ...typed, stamp: 12, list: [1, 2, 3] }));
  await json.click();
  is([await entry('stamp').inputValue(), await entry('list[2]').inputValue(), await entry('text').inputValue(), await entry('deadline_ns').inputValue(), await entry('on').isChecked()], ['12', '3', ALL.text, ALL.order.deadline_ns, true], 'back in the fields');
  await form.getByRole('button', { name: 'remove list[0]' }).click();
  is(await mirrored(), { ...ALL, stamp: 12, list: [2, 3] }, 'what came back then');
  // There is room for four.
  for (const room of [false, true]) {
    await add('list').click();
    is(await add('list').isDisabled(), room, 'full');
  }
  // What fields could not show stays JSON, and the server says what is wrong.
  await form.getByRole('button', { name: 'list as JSON', exact: true }).click();
  await entry('list').fill('{"a": 1}');
  is(await form.getByRole('button', { name: 'list as JSON', exact: true }).isDisabled(), true, 'a list that is none has no rows');
  await invoke();
  await refused.filter({ hasText: /list.* is not a list/ }).waitFor();
  // Another command begins anew.
  await page.getByLabel('Command').selectOption('ctl/twice');
  is([await text.inputValue(), await page.locator('[data-outcome]').count()], ['0', 0], 'the next command');
}

export async function a_stamp_is_shown_and_what_is_left_empty_is_zero(world) {
  const { host, page, entry, invoke, refused } = await formOf(world, 'recorder/recorder', 'host/log', 'ctl/record_at', { directory: world.dir });
  is([await entry('at').inputValue(), await entry('path').inputValue()], ['', ''], 'what it begins from');
  await entry('path').fill('late.mcap');
  await invoke();
  await refused.filter({ hasText: /\bat\b/ }).waitFor();
  await entry('at').fill('5');
  await invoke();
  await refused.filter({ hasText: /\bat\b/ }).waitFor();
  await shot(page, 'invoke-stamp');
  holds(!fs.existsSync(path.join(world.dir, 'late.mcap')), 'nothing is recorded in the past');
  // An argument that is a stamp itself.
  await page.getByLabel('Command').selectOption('ctl/pause_at');
  is(await page.locator('#argument').inputValue(), '0', 'a stamp by itself');
  await page.locator('#argument').fill('');
  await invoke();
  await refused.waitFor();
  holds(!/null/.test(await refused.innerText()), `what is empty is 0: ${await refused.innerText()}`);
  is(await (await grpcurl(host.addr, 'InteractService/Read', { path: 'host/log' })).json.status.phase, 'IDLE', 'phase');
}

export async function any_command_is_invoked_and_wrong_arguments_are_refused_in_the_servers_words(world) {
  const { host, page } = await formOf(world, 'echo', 'host/echo', 'ctl/write');
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
  const { page, wrong } = await formOf(world, 'example/Server', 'host/Server', 'Provided/Write');
  for (const [typed, at, why] of [['300', '300 is above 100 mm', /300 is above maximum 100 mm/], ['-1', '-1 is below 0 mm', /-1 is below minimum 0 mm/]]) {
    await page.locator('#argument').fill(typed);
    is(await wrong('argument').innerText(), at, 'at the field');
    await page.getByRole('button', { name: 'Invoke' }).click();
    await page.locator('[data-outcome].refusal', { hasText: why }).waitFor();
  }
  await shot(page, 'invoke-out-of-range');
}

export async function a_command_with_a_structure_is_invoked_and_names_the_field_that_is_wrong(world) {
  const { host, page } = await formOf(world, 'recorder/recorder', 'host/log', 'ctl/start', { directory: world.dir });
  const argument = page.locator('#argument');
  await page.getByRole('button', { name: 'request as JSON' }).click();
  is(JSON.parse(await argument.inputValue()), { path: '', delay: 0, duration: 0 }, 'all fields are there to be filled in');
  const invoke = async (value) => {
    await argument.fill(JSON.stringify(value));
    await page.getByRole('button', { name: 'Invoke' }).click();
  };
  const file = path.join(world.dir, 'trial.mcap');
  for (const [wrong, why] of [
    [{ path: 'trial.mcap', dely: 0, duration: 0 }, /has no field `dely`; did you mean `delay`\?/],
    [{ path: 'trial.mcap', delay: 0 }, /field `duration` of .* is missing/],
    [{ path: 'trial.mcap', delay: 'soon', duration: 0 }, /delay.*soon/],
    [{ path: 'trial.mcap', delay: 0, duration: -1 }, /duration: -1 s is not between 0 s and 86400 s/],
    [{ path: '../trial.mcap', delay: 0, duration: 0 }, /leads out of the directory/],
  ]) {
    await invoke(wrong);
    await page.locator('[data-outcome].refusal', { hasText: why }).waitFor();
    holds(!fs.existsSync(file), `${JSON.stringify(wrong)} recorded`);
  }
  await shot(page, 'invoke-structure-refused');
  await invoke({ path: 'trial.mcap', delay: 0, duration: 0 });
  await page.locator('[data-outcome]:not(.refusal)').waitFor();
  holds(fs.existsSync(file), 'the file is made');
  const phase = async () => (await grpcurl(host.addr, 'InteractService/Read', { path: 'host/log' })).json.status.phase;
  await eventually('it records', async () => (await phase()) === 'RECORDING');
  await shot(page, 'invoke-structure');
  await page.getByLabel('Command').selectOption('ctl/stop');
  await page.getByRole('button', { name: 'Invoke' }).click();
  await page.locator('[data-outcome]:not(.refusal)').waitFor();
  await eventually('it has ended', async () => (await phase()) === 'IDLE');
}
