/// Points of one curve in a ring: times that only grow, with their values.
///
/// Invariant: memory does not grow with time; a copy is never changed by what comes later.

/// Points kept: more than a minute of 60 Hz, the longest time that "last" shows.
export const KEPT = 4096;
/// A point up to so long before the last one came late; from farther back, another clock counts, s.
const LATE = 1;

export class Track {
  n = 0;
  #first = 0;

  constructor(
    private x = new Float64Array(KEPT),
    private y = new Float64Array(KEPT),
    /// 1 where nothing came or could be read, rather than a value.
    private hole = new Uint8Array(KEPT),
  ) {}

  /// False where nothing changes: it has the time of the last value, or came late.
  add(at: number, value: number): boolean {
    const ends = this.n > 0 && this.isHole(this.n - 1);
    const last = ends ? this.time(this.n - 2) : this.newest;
    if (at === last) {
      // Nothing happened while nothing came: what stands still is no gap.
      if (ends) this.n -= 1;
      return ends;
    }
    // Another run of the machine's clock, or of the component: the curve begins anew.
    if (at <= last - LATE) this.n = this.#first = 0;
    else if (at <= this.newest) return false;
    this.#put(at, value, false);
    return true;
  }

  /// No line leads over it; false where there is one already, or no point.
  gap(): boolean {
    if (this.n === 0 || this.isHole(this.n - 1)) return false;
    this.#put(this.newest + 1e-6, Number.NaN, true);
    return true;
  }

  #put(at: number, value: number, isHole: boolean) {
    const i = (this.#first + this.n) % KEPT;
    this.x[i] = at;
    this.y[i] = value;
    this.hole[i] = isHole ? 1 : 0;
    if (this.n < KEPT) this.n += 1;
    else this.#first = (this.#first + 1) % KEPT;
  }

  copy(): Track {
    const to = new Track(this.x.slice(), this.y.slice(), this.hole.slice());
    to.n = this.n;
    to.#first = this.#first;
    return to;
  }

  /// Time of the k-th oldest, s of the host's monotonic clock.
  time(k: number): number {
    return this.x[(this.#first + k) % KEPT]!;
  }

  value(k: number): number {
    return this.y[(this.#first + k) % KEPT]!;
  }

  isHole(k: number): boolean {
    return this.hole[(this.#first + k) % KEPT] === 1;
  }

  get oldest(): number {
    return this.n ? this.time(0) : Number.NaN;
  }

  get newest(): number {
    return this.n ? this.time(this.n - 1) : Number.NaN;
  }

  /// The first that is not before `at`; n = none is.
  from(at: number): number {
    let [low, high] = [0, this.n];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.time(middle) < at) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /// Nearest to `at`, or the last one before it; undefined: there is none, or nothing came then.
  near(at: number, before: boolean): number | undefined {
    if (!(at >= this.oldest && at <= this.newest + BEYOND)) return undefined;
    const next = this.from(at);
    const isNext = next < this.n && (this.time(next) === at || (!before && (next === 0 || this.time(next) - at < at - this.time(next - 1))));
    const k = isNext ? next : next - 1;
    return k < 0 || this.isHole(k) ? undefined : this.value(k);
  }
}

/// So long after its newest point a curve still has a value, s: others may be ahead of it.
const BEYOND = 0.25;
