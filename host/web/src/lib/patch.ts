/// Merge patches: what somebody changed, and what that leads to.
///
/// Invariant: merge(before, patch(before, now)) is now.
import { isGroup, type Values } from './schema';

/// The parts of `now` that are not as they were. Null where nothing is; undefined: all is as it was.
export function patch(before: unknown, now: unknown): unknown {
  if (JSON.stringify(before) === JSON.stringify(now)) return undefined;
  if (!isGroup(before) || !isGroup(now)) return now;
  const out: Values = {};
  for (const key in now) {
    const part = patch(before[key], now[key]);
    if (part !== undefined) out[key] = part;
  }
  for (const key in before) if (!(key in now)) out[key] = null;
  return Object.keys(out).length ? out : undefined;
}

/// `to` with such parts put into it: null takes away.
export function merge(to: Values, change: unknown): Values {
  const out = { ...to };
  for (const [key, part] of Object.entries((change ?? {}) as Values)) {
    if (part === null) delete out[key];
    else out[key] = isGroup(part) ? merge(isGroup(out[key]) ? out[key] : {}, part) : part;
  }
  return out;
}
