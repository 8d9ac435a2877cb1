/// Runs the tests one after another and tells of them as libtest does: `suite.mjs [--times] [WORD…]`,
/// `suite.mjs --exact NAME…`.
///
/// Invariant: the name in a line `test NAME ... ok` is what --exact takes. Tests of times.mjs judge durations
/// and run only with --times or by name; what there is no test of ends in 2.
import { World, endBrowser } from './world.mjs';
import * as access from './access.mjs';
import * as away from './away.mjs';
import * as changes from './changes.mjs';
import * as classes from './classes.mjs';
import * as firstday from './firstday.mjs';
import * as forms from './forms.mjs';
import * as graph from './graph.mjs';
import * as guard from './guard.mjs';
import * as hidden from './hidden.mjs';
import * as invoke from './invoke.mjs';
import * as layout from './layout.mjs';
import * as live from './live.mjs';
import * as looks from './looks.mjs';
import * as menus from './menus.mjs';
import * as page from './page.mjs';
import * as plots from './plots.mjs';
import * as processes from './processes.mjs';
import * as recording from './recording.mjs';
import * as times from './times.mjs';
import * as tuning from './tuning.mjs';
import * as video from './video.mjs';

const FILES = { firstday, graph, layout, looks, menus, forms, changes, classes, invoke, live, plots, tuning, video, away, hidden, page, guard, recording, processes, access, times };
const all = Object.entries(FILES).flatMap(([file, tests]) => Object.entries(tests).map(([name, test]) => ({ full: `viewer::${file}::${name}`, file, name, test })));
const [exact, onlyTimes] = ['--exact', '--times'].map((option) => process.argv.includes(option));
const words = process.argv.slice(2).filter((word) => !['--exact', '--times'].includes(word));
const means = (word, { full }) => (exact ? full === word : full.includes(word));
const unknown = words.filter((word) => !all.some((one) => means(word, one)));
if (unknown.length || (exact && !words.length)) {
  console.error(`suite.mjs: no test is called ${unknown.join(', ')}`);
  process.exit(2);
}
/// Whether a test was asked for: by name, or as one of its kind.
const chosen = (one) => {
  if (words.length && !words.some((word) => means(word, one))) return false;
  return exact || (words.length && !onlyTimes) || (one.file === 'times') === onlyTimes;
};

let [passed, failed] = [0, 0];
for (const { full, name, test } of all.filter(chosen)) {
  const world = new World();
  let error;
  const began = Date.now();
  try {
    await test(world);
    for (const context of world.contexts) for (const p of context.pages()) if (p.wrong?.length) throw new Error(`the page complained: ${p.wrong.join('\n')}`);
  } catch (e) {
    error = e;
    let n = 0;
    for (const context of world.contexts) for (const p of context.pages()) await p.screenshot({ path: `failed-${name}-${++n}.png`, timeout: 5000 }).catch(() => {});
  }
  await world.end();
  console.log(`test ${full} ... ${error ? 'FAILED' : 'ok'}`);
  console.log(`   ${((Date.now() - began) / 1000).toFixed(1)} s`);
  if (error) {
    failed += 1;
    console.log(error.stack ?? error);
    for (const p of world.programs) console.log(`-- ${p.name} printed:\n${p.printed.slice(-1500)}`);
  } else passed += 1;
}
await endBrowser();
console.log(`test result: ${failed ? 'FAILED' : 'ok'}. ${passed} passed; ${failed} failed; 0 ignored`);
process.exit(failed ? 1 : 0);
