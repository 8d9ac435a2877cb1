/// Settings beside the plots: moved while a component runs, refused in words, and taken back.
import { latest, points } from './following.mjs';
import { drop, OUTPUT, sineShown } from './plotting.mjs';
import { create, eventually, grpcurl, holds, is, reaches, shot } from './world.mjs';

export async function settings_beside_a_plot_move_what_runs_and_are_one_change_each(world) {
  const { host, page } = await sineShown(world, { frequency_hz: 3, phase_rad: 1.5 });
  await create(host.addr, 'filters/low_pass', 'host/low');
  await create(host.addr, 'filters/cartesian_transform', 'host/frame');
  await drop(page, OUTPUT);
  await reaches('points', () => points(page), 10);
  await page.getByRole('button', { name: 'Settings', exact: true }).click();
  const config = async (path = 'host/sine') => (await grpcurl(host.addr, 'GcmService/GetState', { path })).component.config;
  const of = (path, name) => page.locator(`[data-tuning="${path}"] [data-setting="${name}"]`);
  const value = (path, name) => of(path, name).getAttribute('data-value').then(JSON.parse);
  const frequency = of('host/sine', 'frequency_hz').locator('[type=range]');
  is([await frequency.count(), await of('host/sine', 'amplitude').locator('[type=range]').count()], [1, 0], 'a slider only where there are limits');
  // A drag: many values, far fewer calls, one at a time; one change.
  let [open, most, calls] = [0, 0, 0];
  page.on('request', (r) => { if (r.url().endsWith('GcmService/Configure')) { calls += 1; most = Math.max(most, (open += 1)); } });
  for (const over of ['requestfinished', 'requestfailed']) page.on(over, (r) => { if (r.url().endsWith('GcmService/Configure')) open -= 1; });
  const at = await frequency.boundingBox();
  await page.mouse.move(at.x + 10, at.y + at.height / 2);
  await page.mouse.down();
  await page.mouse.move(at.x + at.width - 20, at.y + at.height / 2, { steps: 60 });
  await eventually('it has moved while it is dragged', async () => (await config()).frequency_hz > 400);
  await page.mouse.move(at.x - 30, at.y + at.height / 2, { steps: 60 });
  await page.mouse.up();
  await eventually('the newest won', async () => ((await config()).frequency_hz ?? 0) === 0, config);
  const still = Math.sin(1.5);
  await eventually('the curve stands', async () => Math.abs(Number((await latest(page))[0]) - still) < 1e-9, () => latest(page));
  holds(most === 1 && calls >= 2 && calls < 60, `${calls} calls for 120 values, ${most} at once`);
  const [undo, redo] = ['Undo', 'Redo'].map((name) => page.getByRole('button', { name }));
  await eventually('one change', async () => /Configure host\/sine/.test(await undo.getAttribute('title')));
  await shot(page, 'plot-settings');
  await undo.click();
  await eventually('the whole drag is taken back', async () => (await config()).frequency_hz === 3, config);
  await eventually('and seen', async () => (await value('host/sine', 'frequency_hz')) === 3);
  is(await undo.getAttribute('aria-disabled'), 'true', 'nothing else was changed');
  // Others change it, and it follows.
  await grpcurl(host.addr, 'GcmService/Configure', { path: 'host/sine', config: { frequency_hz: 7 } });
  await eventually('it follows', async () => (await value('host/sine', 'frequency_hz')) === 7 && (await frequency.inputValue()) === '14');
  // A refusal stands beside it, and it is what it was.
  const number = page.getByRole('textbox', { name: 'frequency_hz, as a number' });
  await number.fill('600');
  await number.press('Enter');
  await of('host/sine', 'frequency_hz').getByRole('alert').filter({ hasText: '500' }).waitFor();
  await eventually('the true value', async () => (await value('host/sine', 'frequency_hz')) === 7 && (await number.inputValue()) === '7', () => number.inputValue());
  await shot(page, 'plot-settings-refused');
  await number.fill('abc');
  await number.press('Enter');
  await of('host/sine', 'frequency_hz').getByText('abc is not a number').waitFor();
  is((await config()).frequency_hz, 7, 'what it has');
  // Keys: a number without limits, and another component's slider by powers of ten, switch, choice and items.
  const amplitude = page.getByRole('textbox', { name: 'amplitude' });
  await amplitude.fill('2e-3');
  await amplitude.press('Enter');
  await eventually('amplitude', async () => (await config()).amplitude === 0.002);
  const another = page.getByLabel('settings of another component');
  for (const path of ['host/low', 'host/frame']) await another.selectOption(path);
  const cutoff = of('host/low', 'cutoff_hz').locator('[type=range]');
  await cutoff.fill('500');
  await eventually('half of the way by powers of ten', async () => (await config('host/low')).cutoff_hz === 6.32, () => config('host/low'));
  await eventually('one change', async () => /host\/low/.test(await undo.getAttribute('title')));
  await undo.click();
  await eventually('as before', async () => (await value('host/low', 'cutoff_hz')) === 50);
  // Keys that follow each other are one change; Ctrl-Z takes it back, with the slider in focus.
  await cutoff.focus();
  await Promise.all(['Home', 'ArrowRight', 'PageUp', 'ArrowRight'].map((key) => page.keyboard.press(key)));
  await eventually('the last key counts', async () => (await config('host/low')).cutoff_hz === (await value('host/low', 'cutoff_hz')));
  await eventually('one change', async () => /host\/low/.test(await undo.getAttribute('title')));
  await page.keyboard.press('Control+z');
  await eventually('all are taken back', async () => /host\/low/.test(await redo.getAttribute('title')));
  is((await config('host/low')).cutoff_hz, 50, 'what it had before the first key');
  await page.getByRole('switch', { name: 'inverse' }).click();
  await eventually('the switch', async () => (await config('host/frame')).inverse === true);
  await of('host/frame', 'side').locator('select').selectOption('"behind"');
  await eventually('the choice', async () => (await config('host/frame')).side === 'behind');
  await of('host/frame', 'translation_m[1]').getByRole('textbox').fill('0.25');
  await of('host/frame', 'translation_m[1]').getByRole('textbox').press('Enter');
  await eventually('one item of three', async () => (await config('host/frame')).translation_m?.join() === '0,0.25,0', () => config('host/frame'));
}

/// A page with these components, not yet started, and their settings beside a plot.
async function settingsOf(world, components) {
  const { host, page } = await sineShown(world);
  for (const [path, cls] of Object.entries(components)) await create(host.addr, cls, path);
  await drop(page, OUTPUT);
  await page.getByRole('button', { name: 'Settings', exact: true }).click();
  for (const path of Object.keys(components)) await page.getByLabel('settings of another component').selectOption(path);
  const config = async (path) => (await grpcurl(host.addr, 'GcmService/GetState', { path })).component.config ?? {};
  const slider = (path, name) => page.locator(`[data-tuning="${path}"] [data-setting="${name}"] [type=range]`);
  return { page, config, slider };
}

export async function a_key_s_step_is_taken_back_at_once_and_not_the_change_before_it(world) {
  const { page, config, slider } = await settingsOf(world, { 'host/low': 'filters/low_pass' });
  const amplitude = page.getByRole('textbox', { name: 'amplitude' });
  await amplitude.fill('3');
  await amplitude.press('Enter');
  const [undo, redo] = ['Undo', 'Redo'].map((name) => page.getByRole('button', { name }));
  await eventually('the change before it', async () => /host\/sine/.test(await undo.getAttribute('title')));
  await slider('host/low', 'cutoff_hz').focus();
  await Promise.all(['ArrowRight', 'Control+z'].map((key) => page.keyboard.press(key)));
  await eventually('the step can be done again', async () => /host\/low/.test(await redo.getAttribute('title')), () => redo.getAttribute('title'));
  is([(await config('host/low')).cutoff_hz, (await config('host/sine')).amplitude], [50, 3], 'cutoff_hz as before, amplitude as it was set');
  holds(/host\/sine/.test(await undo.getAttribute('title')), 'the change before it can be taken back');
}

export async function keys_that_follow_each_other_are_one_change_though_each_was_answered(world) {
  const { page, config, slider } = await settingsOf(world, { 'host/low': 'filters/low_pass' });
  const [undo, redo] = ['Undo', 'Redo'].map((name) => page.getByRole('button', { name }));
  const cutoff = slider('host/low', 'cutoff_hz');
  // The page's clock stands still between the keys, however long their answers take.
  await page.clock.install();
  await page.clock.pauseAt((await page.evaluate(() => Date.now())) + 1000);
  await cutoff.focus();
  for (const key of ['Home', 'PageUp', 'End']) {
    const had = (await config('host/low')).cutoff_hz;
    await page.keyboard.press(key);
    await eventually(`${key} is answered`, async () => (await config('host/low')).cutoff_hz !== had);
    await page.clock.runFor(300);
  }
  await page.clock.runFor(600);
  await eventually('a change', async () => /host\/low/.test(await undo.getAttribute('title')));
  await undo.click();
  await eventually('it is taken back', async () => /host\/low/.test(await redo.getAttribute('title')));
  is((await config('host/low')).cutoff_hz, 50, 'what it had before the first key');
}

export async function a_slider_reaches_few_whole_numbers_by_a_key_each_and_tiny_ones_by_their_place(world) {
  const { page, config, slider } = await settingsOf(world, { 'host/move': 'eyerobot/joint_mover', 'host/kalman': 'filters/kalman' });
  const joint = slider('host/move', 'joint');
  await joint.focus();
  const sent = () => page.locator('[data-tuning="host/move"]').getAttribute('data-sent');
  for (const [key, wanted] of [['ArrowLeft', 1], ['ArrowLeft', 0], ['ArrowRight', 1], ['End', 2]]) {
    await page.keyboard.press(key);
    await eventually(`${key} moves it to ${wanted}`, async () => ((await config('host/move')).joint ?? 0) === wanted && (await joint.inputValue()) === String(wanted), () => config('host/move'));
  }
  is(await sent(), '4', 'a call for each key');
  await page.keyboard.press('ArrowRight');
  await joint.evaluate((e) => e.dispatchEvent(new Event('input')));
  is(await sent(), '4', 'none for a value that stays');
  // From 1e-24 to 1e24.
  const acceleration = slider('host/kalman', 'acceleration');
  for (const [place, wanted] of [[125, 1e-18], [20, 9.12e-24], [500, 1]]) {
    await acceleration.fill(String(place));
    await eventually(`place ${place} is ${wanted}`, async () => (await config('host/kalman')).acceleration === wanted, () => config('host/kalman'));
  }
}

export async function whole_numbers_of_64_bits_are_set_and_shown_to_the_last_digit(world) {
  const { page, config } = await settingsOf(world, { 'host/echo': 'echo' });
  for (const [name, number] of [['exact', '9007199254740993'], ['signed', '-9007199254740993']]) {
    const setting = page.locator(`[data-tuning="host/echo"] [data-setting="${name}"]`);
    const box = setting.getByRole('textbox');
    await box.fill(number);
    await box.press('Enter');
    await eventually(`${name} is what was typed`, async () => (await config('host/echo'))[name] === number, () => config('host/echo'));
    await eventually(`${name} is shown`, async () => (await setting.getAttribute('data-value')) === JSON.stringify(number) && (await box.inputValue()) === number, () => box.inputValue());
  }
}
