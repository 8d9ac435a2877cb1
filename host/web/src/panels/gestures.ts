/// Wheel and fingers over the curves of a plot.
///
/// Invariant: they change the time that is seen of all plots, and nothing else.
import { plots, type Plot } from '../lib/plots.svelte';

/// Wheel and two fingers zoom, one finger moves along.
export function gestures(over: HTMLElement, plot: Plot) {
  // The time asked for last may not be drawn yet.
  const seen = () => plots.seen(plot);
  const timeAt = (left: number) => seen().from + (left / (over.clientWidth || 1)) * (seen().to - seen().from);
  over.style.touchAction = 'pan-y';
  over.addEventListener('wheel', (e) => {
    e.preventDefault();
    const way = e.deltaY || e.deltaX;
    if (e.shiftKey || Math.abs(e.deltaX) > Math.abs(e.deltaY)) plots.shift(Math.sign(e.deltaX || way) * 0.1, seen());
    else if (way) plots.scale(1.2 ** Math.max(-3, Math.min(3, way / 50)), timeAt(e.offsetX), seen());
  }, { passive: false });
  const fingers = new Map<number, number>();
  const at = (e: PointerEvent) => e.clientX - over.getBoundingClientRect().left;
  over.addEventListener('pointerdown', (e) => e.pointerType === 'touch' && fingers.set(e.pointerId, at(e)));
  for (const end of ['pointerup', 'pointercancel', 'pointerleave'] as const) over.addEventListener(end, (e) => fingers.delete(e.pointerId));
  over.addEventListener('pointermove', (e) => {
    if (!fingers.has(e.pointerId)) return;
    const before = [...fingers.values()];
    fingers.set(e.pointerId, at(e));
    const now = [...fingers.values()];
    if (now.length === 1 && now[0] !== before[0]) plots.shift((before[0]! - now[0]!) / (over.clientWidth || 1), seen());
    else if (now.length === 2) {
      const [was, is] = [Math.abs(before[0]! - before[1]!), Math.abs(now[0]! - now[1]!)];
      if (was > 10 && is > 10) plots.scale(was / is, timeAt((now[0]! + now[1]!) / 2), seen());
    }
  });
}
