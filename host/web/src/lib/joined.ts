/// Curves of a plot beside one column of times.
///
/// Invariant: points of two curves are never moved onto each other; the arrays are filled again each time.
import type { Track } from './track';

export class Joined {
  readonly data: [number[], ...(number | null | undefined)[][]] = [[]];
  #at: number[] = [];
  #stop: number[] = [];

  /// Takes the points from `from` to `to`, and one on either side: lines lead to the edges. Times count from
  /// `base`.
  fill(tracks: readonly Track[], from: number, to: number, base: number) {
    const { data } = this;
    while (data.length <= tracks.length) data.push([]);
    data.length = tracks.length + 1;
    tracks.forEach((track, k) => {
      this.#at[k] = Math.max(0, track.from(from) - 1);
      this.#stop[k] = Math.min(track.n, track.from(to) + 1);
    });
    const times = data[0];
    let row = 0;
    for (;;) {
      let time = Infinity;
      for (let k = 0; k < tracks.length; k += 1) if (this.#at[k]! < this.#stop[k]!) time = Math.min(time, tracks[k]!.time(this.#at[k]!));
      if (time === Infinity) break;
      times[row] = time - base;
      for (let k = 0; k < tracks.length; k += 1) {
        const at = this.#at[k]!;
        if (at < this.#stop[k]! && tracks[k]!.time(at) === time) {
          const value = tracks[k]!.value(at);
          data[k + 1]![row] = Number.isFinite(value) ? value : null;
          this.#at[k] = at + 1;
        } else data[k + 1]![row] = undefined;
      }
      row += 1;
    }
    for (const column of data) column.length = row;
  }
}
