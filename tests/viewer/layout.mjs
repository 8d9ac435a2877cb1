/// The picture at first sight: its layout, the size of its letters, and that nothing is out of reach.
import { small } from './letters.mjs';
import { box, connect, create, eventually, grpcurl, handle, holds, is, settled, shot, start } from './world.mjs';

/// Places where a wire goes through a card that is not at its ends.
const crossed = (page) =>
  page.evaluate(() => {
    const cards = [...document.querySelectorAll('[data-path]')].map((e) => ({ path: e.dataset.path, box: e.getBoundingClientRect() }));
    const found = [];
    for (const wire of document.querySelectorAll('path.wire')) {
      const [long, to] = [wire.getTotalLength(), wire.getScreenCTM()];
      for (let at = 0; at <= long; at += 4) {
        const { x, y } = wire.getPointAtLength(at).matrixTransform(to);
        const over = cards.find(({ box: b }) => x > b.left + 8 && x < b.right - 8 && y > b.top + 2 && y < b.bottom - 2);
        if (over) { found.push(`${wire.closest('[aria-label]').getAttribute('aria-label')} goes through ${over.path}`); break; }
      }
    }
    return found;
  });

/// Points of a card that are outside of the graph's own area, or below something else.
const covered = (page, path) =>
  page.evaluate((path) => {
    const b = document.querySelector(`[data-path="${path}"]`).getBoundingClientRect();
    const out = [];
    for (const [fx, fy] of [[0.03, 0.06], [0.97, 0.06], [0.03, 0.94], [0.97, 0.94], [0.5, 0.5]]) {
      const [x, y] = [b.left + b.width * fx, b.top + b.height * fy];
      const top = document.elementFromPoint(x, y);
      if (!top?.closest(`[data-path="${path}"]`)) out.push(`${fx}, ${fy}: ${top?.className?.baseVal ?? top?.className ?? 'outside of the window'}`);
    }
    return out;
  }, path);

const wires = (page) => page.locator('path.wire').count();

export async function the_demo_can_be_read_at_first_sight_and_no_wire_goes_through_a_card(world) {
  const demo = await world.demo();
  const { connections } = await grpcurl(demo.addr, 'GcmService/List', {});
  for (const [width, height] of [[1366, 768], [1920, 1080]]) {
    const page = await world.viewer(demo.addr, '', { viewport: { width, height } });
    await settled(page);
    await eventually('all wires are drawn', async () => (await wires(page)) === connections.length, () => wires(page));
    await eventually('figures stand at a wire', () => page.locator('[data-connection]', { hasText: /\d\/s/ }).count());
    is(await small(page), [], `small letters at ${width} × ${height}`);
    await eventually('ports are named', () => page.locator('[data-port="host/robot/virtual_fixture"] span').isVisible());
    is(await crossed(page), [], `wires at ${width} × ${height}`);
    await shot(page, `demo-${width}`);
    await page.context().close();
  }
}

/// What labels of lines cover, what is cut of names and footers, and names of which a word is broken.
const muddled = (page) =>
  page.evaluate(() => {
    const boxes = (of) => [...document.querySelectorAll(of)].map((e) => ({ e, b: e.getBoundingClientRect() })).filter(({ b }) => b.width > 0);
    const area = (a, b) => Math.max(0, Math.min(a.right, b.right) - Math.max(a.left, b.left) - 1) * Math.max(0, Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) - 1);
    const [labels, cards, handles] = [boxes('.flow'), boxes('[data-path]'), boxes('.svelte-flow__handle')];
    const name = (e) => e.dataset.connection ?? e.dataset.path ?? `${e.closest('[data-path]')?.dataset.path} ${e.dataset.handleid ?? e.textContent}`;
    const found = [];
    labels.forEach(({ e, b }, n) => {
      for (const other of [...cards, ...handles, ...labels.slice(n + 1)]) if (area(b, other.b) > 0) found.push(`the label of ${name(e)} covers ${name(other.e)}`);
      if (e.scrollWidth > e.clientWidth + 1) found.push(`the label of ${name(e)} is cut`);
    });
    for (const { e } of [...boxes('.component footer'), ...boxes('.component footer span'), ...boxes('.process header .pid'), ...boxes('.component strong span')]) if (e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).display !== 'inline') found.push(`cut: ${name(e)}`);
    for (const { e } of boxes('.component strong span')) if (e.getClientRects().length > 1) found.push(`broken: ${name(e)}`);
    return found;
  });

export async function labels_cover_no_card_port_or_other_label_and_no_word_is_broken_or_cut(world) {
  const demo = await world.demo();
  const tablet = { viewport: { width: 820, height: 1180 }, hasTouch: true, isMobile: true };
  for (const options of [{ viewport: { width: 1366, height: 768 } }, { viewport: { width: 1920, height: 1080 } }, tablet]) {
    const page = await world.viewer(demo.addr, '', options);
    const at = options.viewport.width;
    await settled(page);
    await eventually('figures stand at the lines', async () => (await page.locator('.flow:visible', { hasText: /[1-9].*\/s/ }).count()) > 5, () => page.locator('.flow:visible').allInnerTexts());
    // Digits change: what is seen is looked at more than once.
    for (let n = 0; n < 4; n += 1) {
      is(await muddled(page), [], `at ${at}`);
      await page.waitForResponse((r) => r.url().endsWith('GcmService/List'));
    }
    await shot(page, `labels-${at}`);
    await box(page, 'host/robot').locator('header').click();
    await page.locator('.inspector').waitFor();
    await settled(page);
    is(await muddled(page), [], `at ${at}, beside a panel`);
    await shot(page, `labels-panel-${at}`);
    await page.context().close();
  }
}

export async function a_click_on_a_line_leaves_no_card_below_the_panel_buttons_or_overview_as_a_click_on_a_card_does(world) {
  const demo = await world.demo();
  const page = await world.viewer(demo.addr, '', { viewport: { width: 1366, height: 768 } });
  await settled(page);
  const paths = await page.locator('[data-path]').evaluateAll((all) => all.map((e) => e.dataset.path));
  const below = async () => (await Promise.all(paths.map(async (path) => [path, ...(await covered(page, path))]))).filter((c) => c.length > 1);
  const line = page.locator('[data-connection="host/robot/arm → host/bscan/robot"]:visible');
  for (const click of [() => line.click(), () => box(page, 'host/robot').locator('header').click()]) {
    await line.waitFor();
    await click();
    await page.locator('.inspector').waitFor();
    await eventually('each card is seen whole', async () => (await below()).length === 0, below);
    await shot(page, 'line-panel');
    await page.keyboard.press('Escape');
    await page.locator('.inspector').waitFor({ state: 'detached' });
    await eventually('the graph has its room again', async () => (await below()).length === 0, below);
  }
  // A view that was moved shows both ends of the line that is clicked, and the overview covers no card.
  await page.locator('.svelte-flow__controls-zoomin').click();
  await page.locator('.svelte-flow__edge[aria-label="host/depth/depth to host/depth_map/picture"]').focus();
  await page.keyboard.press('Enter');
  await page.locator('.inspector').waitFor();
  const ends = async () => (await Promise.all(['host/depth', 'host/depth_map'].map((path) => covered(page, path)))).flat();
  await eventually('both ends are seen', async () => (await ends()).length === 0, ends);
  const map = page.locator('.svelte-flow__minimap');
  const over = async () => {
    if (!(await map.count())) return [];
    const m = await map.boundingBox();
    return page.locator('[data-path]').evaluateAll((all, m) => all.filter((e) => { const b = e.getBoundingClientRect(); return b.right > m.x + 1 && b.left < m.x + m.width - 1 && b.bottom > m.y + 1 && b.top < m.y + m.height - 1; }).map((e) => e.dataset.path), m);
  };
  await eventually('the overview covers no card', async () => (await over()).length === 0, over);
  await shot(page, 'line-moved-view');
}

export async function a_tall_window_gets_a_tall_picture_whose_names_can_be_read(world) {
  const demo = await world.demo();
  const page = await world.viewer(demo.addr, '', { viewport: { width: 820, height: 1180 }, hasTouch: true, isMobile: true });
  await settled(page);
  is(await small(page), [], 'small letters');
  is(await crossed(page), [], 'wires');
  const shape = () => page.locator('[data-process=host]').boundingBox();
  const tall = await shape();
  holds(tall.height > tall.width * 0.9 && tall.width > 700, `a tall picture: ${JSON.stringify(tall)}`);
  await shot(page, 'demo-tall');
  await page.setViewportSize({ width: 1180, height: 820 });
  await eventually('a broad window gets a broad one', async () => { const b = await shape(); return b.width > b.height * 1.3; }, shape);
  await settled(page);
  is(await crossed(page), [], 'wires of the broad one');
}

export async function outputs_stand_before_system_on_every_card(world) {
  const demo = await world.demo();
  const page = await world.viewer(demo.addr, '', { viewport: { width: 1920, height: 1080 } });
  await page.keyboard.press('t');
  await settled(page);
  const wrong = await page.evaluate(() => [...document.querySelectorAll('[data-path]')].flatMap((card) => {
    const right = [...card.querySelectorAll('.port.right')].sort((a, b) => a.getBoundingClientRect().top - b.getBoundingClientRect().top);
    const kinds = right.map((p) => [p.dataset.port, p.querySelector('.output') !== null]);
    const at = kinds.findIndex(([port]) => port.endsWith('/system'));
    return kinds.slice(at + 1).filter(([, isOutput]) => isOutput).map(([port]) => port).concat(at < 0 ? [`${card.dataset.path} shows no system`] : []);
  }));
  is(wrong, [], 'outputs below system');
}

export async function a_wire_that_comes_later_and_one_of_a_card_that_was_moved_go_around_cards(world) {
  const host = await world.host();
  for (const name of ['a', 'b', 'c', 'd']) await create(host.addr, 'echo', `host/${name}`);
  await connect(host.addr, 'host/b/sample', 'host/a/sample_out');
  await connect(host.addr, 'host/c/sample', 'host/b/sample_out');
  await connect(host.addr, 'host/d/sample', 'host/c/sample_out');
  const page = await world.viewer(host.addr);
  await settled(page);
  is(await crossed(page), [], 'wires of the layout');
  const left = async (name) => (await page.locator(`.svelte-flow__node[data-id="host/${name}"]`).boundingBox()).x;
  holds((await left('a')) < (await left('b')) && (await left('b')) < (await left('c')), 'what gives stands left of what takes');
  // A hand that moved the view has kept the places.
  await page.mouse.move(300, 800);
  await page.mouse.wheel(0, 40);
  // From the last to the first: back below all of them.
  await connect(host.addr, 'host/a/frame', 'host/d/frame_out');
  await eventually('it is drawn', async () => (await wires(page)) === 4, () => wires(page));
  is(await crossed(page), [], 'with a wire that came later');
  const node = page.locator('.svelte-flow__node[data-id="host/c"]');
  const from = await node.boundingBox();
  const before = await page.locator('.svelte-flow__node[data-id="host/b"]').boundingBox();
  await page.mouse.move(from.x + 60, from.y + 12);
  await page.mouse.down();
  await page.mouse.move(from.x, from.y + 200, { steps: 5 });
  await page.mouse.move(before.x + 60, before.y + before.height + 60, { steps: 5 });
  await page.mouse.up();
  await eventually('the card stands elsewhere and its wires go around the others', async () => {
    const now = await node.boundingBox();
    return now.y > from.y + 60 && (await crossed(page)).length === 0;
  }, () => crossed(page));
  await shot(page, 'wires-around');
}

export async function no_button_of_the_top_is_out_of_reach_however_narrow_the_window_is(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  await create(host.addr, 'fixture-chaos/chaos', 'host/chaos', { panic_in: 'step' }, { model: 'periodic', rate_hz: 10 });
  await create(host.addr, 'recorder/recorder', 'host/log', { directory: world.dir, path: 'trial.mcap' });
  await connect(host.addr, 'host/log/in_1', 'host/sine/value');
  await start(host.addr, 'host/**');
  const page = await world.viewer(host.addr, '', { viewport: { width: 1920, height: 700 } });
  await settled(page);
  await page.locator('.tally', { hasText: '1 in FAULT' }).waitFor();
  await page.locator('[data-recording="1"]').waitFor();
  const tops = () => page.locator('.tools > :is(button, a)').evaluateAll((all) => all.map((e) => ({ name: e.getAttribute('aria-label') ?? e.textContent.trim(), left: e.getBoundingClientRect().left, right: e.getBoundingClientRect().right })));
  const all = (await tops()).map((t) => t.name);
  holds(all.length >= 13 && !all.includes('Menu'), `all buttons of a broad window: ${all}`);
  for (const width of [1920, 1366, 1000, 820, 600, 360, 300]) {
    await page.setViewportSize({ width, height: 700 });
    const record = await page.locator('[data-recording]').boundingBox();
    holds(record.x >= 0 && record.x + record.width <= width, `the recording at ${width} px: ${JSON.stringify(record)}`);
    await eventually('the buttons are inside the window', async () => (await tops()).every((t) => t.left >= 0 && t.right <= width), tops);
    const names = async () => (await tops()).map((t) => t.name);
    if (!(await names()).includes('Menu')) { is(await names(), all, `at ${width} px`); continue; }
    await page.getByRole('button', { name: 'Menu', exact: true }).click();
    // The time and size of the recording, which take room from the buttons, change each second until it is open.
    const shown = await names();
    const listed = await page.locator('.menu :is([role=menuitem], [role=menuitemcheckbox]) span').allInnerTexts();
    is([...shown.slice(0, -1), ...listed], all, `at ${width} px`);
    const menu = await page.locator('.menu').boundingBox();
    holds(menu.x >= 0 && menu.x + menu.width <= width && menu.y + menu.height <= 700, `the menu at ${width} px: ${JSON.stringify(menu)}`);
    if (width === 300) await shot(page, 'narrow-menu');
    await page.keyboard.press('Escape');
    await page.locator('.menu').waitFor({ state: 'detached' });
  }
  // A line of the menu does what its button does.
  await page.getByRole('button', { name: 'Menu', exact: true }).click();
  await page.getByRole('menuitemcheckbox', { name: /^Log/ }).click();
  await page.locator('.dock [role=log]').waitFor();
  await page.getByRole('button', { name: 'Menu', exact: true }).click();
  is(await page.getByRole('menuitemcheckbox', { name: /^Log/ }).getAttribute('aria-checked'), 'true', 'Log, while it is open');
}

export async function a_selected_card_is_never_below_a_panel(world) {
  const demo = await world.demo();
  for (const [width, height] of [[1366, 768], [700, 1000]]) {
    const page = await world.viewer(demo.addr, '', { viewport: { width, height } });
    await settled(page);
    const paths = ['host/robot', 'host/display', 'host/oct_image', 'host/camera'];
    for (const path of paths) {
      await box(page, path).locator('header').click({ force: true });
      await page.locator('.inspector strong', { hasText: path }).waitFor();
      await eventually(`${path} is seen whole`, async () => (await covered(page, path)).length === 0, () => covered(page, path));
    }
    await page.keyboard.press('Escape');
    await page.locator('.inspector').waitFor({ state: 'detached' });
    // The same in a view that was moved and brought near.
    await page.locator('.svelte-flow__controls-zoomin').click();
    await page.locator('.svelte-flow__controls-zoomin').click();
    for (const path of paths) {
      await page.keyboard.press('Control+k');
      await page.getByRole('combobox', { name: 'search' }).fill(path);
      await page.locator('#found [role=option][aria-selected=true]', { hasText: path }).waitFor();
      await page.keyboard.press('Enter');
      await eventually(`${path} is seen whole from near`, async () => (await covered(page, path)).length === 0, () => covered(page, path));
    }
    await shot(page, `selected-${width}`);
    await page.context().close();
  }
}
