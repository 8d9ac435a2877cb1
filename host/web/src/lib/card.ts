/// The measures of a card: as narrow as its words allow, since a graph is broad and a window is not.
///
/// Invariant: layout, ends of wires and picture of a card use these numbers; the screen is not measured.
import { isClient, type Port } from './ports.svelte';

export const HEAD = 48;
export const ROW = 20;
export const FOOT = 24;
/// Text of 11 px is drawn up to so many times as large in a view that is far away, and still has its room.
export const LARGEST = 1.45;
/// Below the last row, px.
const BELOW = 8;
const NARROWEST = 150;
const WIDEST = 236;
/// Width of a character at its largest, px: of a port's name and of a component's.
const LETTER = 8.2;
const BOLD = 10;
/// Room beside the names of a row, and of the head, px.
const BESIDE = 30;
const BESIDE_NAME = 44;

export interface Spot {
  port: Port;
  left: boolean;
  /// Middle of its row, px below the card's top.
  y: number;
}

export interface Card {
  width: number;
  height: number;
  spots: Spot[];
}

/// The card of a component with this name and these ports.
export function cardOf(name: string, ports: Port[]): Card {
  const left = ports.filter((p) => isClient(p.kind));
  const right = ports.filter((p) => !isClient(p.kind));
  const widest = Math.max(0, ...ports.map((p) => wide(p)));
  const width = Math.round(Math.min(WIDEST, Math.max(NARROWEST, widest + BESIDE, name.length * BOLD + BESIDE_NAME)));
  const down = below(left, right, width - BESIDE);
  const rows = Math.max(left.length, right.length ? down + right.length : 0, 1);
  const y = (row: number) => HEAD + row * ROW + ROW / 2;
  return {
    width,
    height: HEAD + rows * ROW + FOOT + BELOW,
    spots: [...left.map((port, i) => ({ port, left: true, y: y(i) })), ...right.map((port, i) => ({ port, left: false, y: y(down + i) }))],
  };
}

function wide(port: Port): number {
  return port.name.length * LETTER;
}

/// Rows by which the right side begins lower, so that no two names of a row meet.
function below(left: Port[], right: Port[], room: number): number {
  for (let down = 0; down < left.length; down += 1) {
    if (right.every((p, i) => !left[down + i] || wide(p) + wide(left[down + i]!) <= room)) return down;
  }
  return left.length;
}
