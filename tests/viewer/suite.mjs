/// Runs the tests one after another and tells of them as libtest does; names in the arguments choose some.
import { World } from './world.mjs';
import * as access from './access.mjs';
import * as away from './away.mjs';
import * as classes from './classes.mjs';
import * as forms from './forms.mjs';
import * as graph from './graph.mjs';
import * as guard from './guard.mjs';
import * as hidden from './hidden.mjs';
import * as invoke from './invoke.mjs';
import * as live from './live.mjs';
import * as menus from './menus.mjs';
import * as page from './page.mjs';
import * as video from './video.mjs';

const wanted = process.argv.slice(2);
let [passed, failed] = [0, 0];
for (const [file, tests] of Object.entries({ graph, menus, forms, classes, invoke, live, video, away, hidden, page, guard, access })) {
  for (const [name, test] of Object.entries(tests)) {
    const full = `viewer::${file}::${name}`;
    if (wanted.length && !wanted.some((w) => full.includes(w))) continue;
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
    console.log(`test ${full} ... ${error ? 'FAILED' : 'ok'} (${((Date.now() - began) / 1000).toFixed(1)} s)`);
    if (error) {
      failed += 1;
      console.log(error.stack ?? error);
      for (const p of world.programs) console.log(`-- ${p.name} printed:\n${p.printed.slice(-1500)}`);
    } else passed += 1;
  }
}
console.log(`test result: ${failed ? 'FAILED' : 'ok'}. ${passed} passed; ${failed} failed; 0 ignored`);
process.exit(failed ? 1 : 0);
