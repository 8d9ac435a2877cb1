//! Delays samples of any type, to try the effect of a slow connection.
//!
//! Invariant: samples leave in their order with the stamp they came with, none before its delay is over and
//! none altered.
use trocar_sdk::prelude::*;

#[derive(Config)]
struct AddLatencyConfig {
    /// Delay of each sample; the component's period comes on top
    #[config(live, min = 0.0, max = 60.0, unit = "s", default = 0.01)]
    delay_s: f64,
    /// Up to how much longer, evenly spread
    #[config(live, min = 0.0, max = 60.0, unit = "s", default = 0.0)]
    jitter_s: f64,
    /// Seed of the jitter
    #[config(default = 1)]
    seed: u64,
    /// Most samples that are under way; more are left out
    #[config(min = 1, max = 65536, default = 1024)]
    depth: usize,
    /// Largest sample
    #[config(min = 8, max = 65536, unit = "B", default = 1024)]
    max_bytes: usize,
}

/// A delay line.
#[derive(Component)]
#[component(rate_hz = 1000)]
pub struct AddLatency {
    #[input(fifo = 64)]
    sample: AnyIn,
    /// The same type as that of `sample`
    #[output]
    delayed: AnyOut,
    /// Samples under way.
    #[state]
    waiting: u64,
    /// Samples left out: too large, too many, or of another type than the output's.
    #[state]
    rejected: u64,
    #[config]
    cfg: AddLatencyConfig,
    line: Vec<Waiting>,
    /// Sample that leaves next, of all that ever came.
    first: u64,
    random: Option<fastrand::Rng>,
}

#[derive(Clone)]
struct Waiting {
    bytes: Vec<u8>,
    len: usize,
    stamp: Stamp,
    leaves_ns: u64,
}

impl Component for AddLatency {
    fn configure(&mut self) -> Result {
        let AddLatencyConfig { depth, max_bytes, .. } = self.cfg;
        if depth * max_bytes > 256 << 20 {
            return Err(format!(
                "depth, max_bytes: {depth} samples of {max_bytes} B are more than 256 MiB: lower one"
            )
            .into());
        }
        if self.line.len() != depth || self.line.first().is_none_or(|place| place.bytes.len() != max_bytes) {
            let place = Waiting { bytes: vec![0; max_bytes], len: 0, stamp: Stamp::INVALID, leaves_ns: 0 };
            self.line = vec![place; depth];
            (self.first, self.waiting) = (0, 0);
        }
        Ok(())
    }

    fn start(&mut self) -> Result {
        (self.first, self.waiting, self.rejected) = (0, 0, 0);
        self.random = Some(fastrand::Rng::with_seed(self.cfg.seed));
        Ok(())
    }

    fn step(&mut self, t: &Tick) -> Result {
        let depth = self.line.len() as u64;
        let mut before_ns = match self.waiting {
            0 => 0,
            waiting => self.line[((self.first + waiting - 1) % depth) as usize].leaves_ns,
        };
        while let Some(sample) = self.sample.next() {
            let value = sample.value();
            let place = &mut self.line[((self.first + self.waiting) % depth) as usize];
            if self.waiting == depth || value.len() > place.bytes.len() {
                self.rejected += 1;
                continue;
            }
            place.bytes[..value.len()].copy_from_slice(value);
            (place.len, place.stamp) = (value.len(), sample.stamp());
            let spread = self.random.as_mut().map_or(0.0, fastrand::Rng::f64) * self.cfg.jitter_s;
            let kept_ns = ((self.cfg.delay_s + spread) * 1e9) as u64;
            // A later one never overtakes.
            place.leaves_ns = (t.now().ns() + kept_ns).max(before_ns);
            before_ns = place.leaves_ns;
            self.waiting += 1;
        }
        while self.waiting > 0 {
            let place = &self.line[(self.first % depth) as usize];
            if place.leaves_ns > t.now().ns() {
                break;
            }
            let written = self.delayed.write_bytes(&place.bytes[..place.len], place.stamp);
            self.rejected += u64::from(written == Outcome::InvalidArgument);
            self.first += 1;
            self.waiting -= 1;
        }
        Ok(())
    }
}
