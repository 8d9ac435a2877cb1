/// A plot as a table and as a picture, for this person's disk.
///
/// Invariant: they hold the time that is seen, with no value made up and no digit lost.
import type { Look } from './palette';
import { nameOf, type Curve } from './signals.svelte';
import { unitOf } from './si';
import type { Span } from './plots.svelte';

/// Time the browser has to begin, ms.
const BEGINS = 60_000;
/// Room around a picture, px.
const EDGE = 12;

export function deliver(blob: Blob, name: string) {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), BEGINS);
}

/// Signal and time of day, without an ending.
export function fileName(curves: Curve[], when: Date): string {
  const first = nameOf(curves[0]!.signal).replace(/[^A-Za-z0-9_-]+/g, '.').replace(/^\.+|\.+$/g, '');
  const two = (n: number) => String(n).padStart(2, '0');
  const day = `${when.getFullYear()}-${two(when.getMonth() + 1)}-${two(when.getDate())}`;
  const more = curves.length > 1 ? `-and-${curves.length - 1}-more` : '';
  return `${first}${more}-${day}T${two(when.getHours())}-${two(when.getMinutes())}-${two(when.getSeconds())}`;
}

function quoted(text: string): string {
  return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

/// The shortest text that reads as the very same number.
function exact(value: number): string {
  return Number.isNaN(value) ? 'nan' : Number.isFinite(value) ? String(value) : value > 0 ? 'inf' : '-inf';
}

/// A row for each time at which some curve has a point; relative times count from `base`.
export function table(curves: Curve[], { from, to }: Span, base: number): string {
  const unit = (c: Curve) => (c.signal.names ? ' (enum)' : unitOf(c.signal.unit) && ` (${unitOf(c.signal.unit)})`);
  const lines = [['time (s)', 'relative (s)', ...curves.map((c) => quoted(nameOf(c.signal) + unit(c)))].join(',')];
  const rows = new Map<number, string[]>();
  curves.forEach((curve, column) => {
    const { seen } = curve;
    for (let k = seen.from(from); k < seen.n && seen.time(k) <= to; k += 1) {
      if (seen.isHole(k)) continue;
      const row = rows.get(seen.time(k)) ?? new Array<string>(curves.length).fill('');
      row[column] = exact(seen.value(k));
      rows.set(seen.time(k), row);
    }
  });
  for (const [time, row] of [...rows].sort(([a], [b]) => a - b)) lines.push([time.toFixed(9), (time - base).toFixed(9), ...row].join(','));
  return `${lines.join('\n')}\n`;
}

export interface Line extends Look {
  text: string;
}

/// The drawn curves below their title and legend.
export async function picture(drawn: HTMLCanvasElement, title: string, legend: Line[], { ground, ink }: { ground: string; ink: string }): Promise<Blob> {
  // The drawing has the pixels of the screen.
  const ratio = drawn.width / Math.max(1, drawn.clientWidth);
  const row = 18;
  const top = EDGE + row * (1 + legend.length) + 8;
  const canvas = document.createElement('canvas');
  const draw = canvas.getContext('2d')!;
  const font = (weight: string) => `${weight} 12px system-ui, 'DejaVu Sans', sans-serif`;
  draw.font = font('600');
  const texts = [draw.measureText(title).width, ...legend.map((l) => draw.measureText(l.text).width + 34)];
  canvas.width = Math.ceil(Math.max(drawn.width / ratio, ...texts) + 2 * EDGE) * ratio;
  canvas.height = Math.ceil(top + drawn.height / ratio + EDGE) * ratio;
  draw.scale(ratio, ratio);
  draw.fillStyle = ground;
  draw.fillRect(0, 0, canvas.width, canvas.height);
  draw.textBaseline = 'middle';
  draw.fillStyle = ink;
  draw.font = font('600');
  draw.fillText(title, EDGE, EDGE + row / 2);
  draw.font = font('400');
  legend.forEach((line, n) => {
    const y = EDGE + row * (n + 1.5);
    draw.strokeStyle = line.colour;
    draw.lineWidth = 2;
    draw.setLineDash(line.dash);
    draw.beginPath();
    draw.moveTo(EDGE, y);
    draw.lineTo(EDGE + 26, y);
    draw.stroke();
    draw.fillText(line.text, EDGE + 34, y);
  });
  draw.drawImage(drawn, EDGE, top, drawn.width / ratio, drawn.height / ratio);
  return new Promise((yes, no) => canvas.toBlob((blob) => (blob ? yes(blob) : no(new Error('the browser made no picture of it'))), 'image/png'));
}
