//! Watches whether data still come, and lets a device hold when they do not.
//!
//! Invariant: lost and found are told once each, in turn; the device is told to hold each time data are lost.
use trocar_sdk::prelude::*;

#[derive(Config)]
struct WatchdogConfig {
    /// Age of the newest sample at which the data count as lost
    #[config(live, min = 0.0001, max = 3600.0, unit = "s", default = 0.05)]
    timeout_s: f64,
}

/// Tells when samples of any type are too old, and calls `hold` of whatever is connected.
#[derive(Component)]
#[component(rate_hz = 1000, provides("ctl"))]
pub struct Watchdog {
    #[input]
    watched: AnyIn,
    #[required(interface = "device", optional)]
    hold: Function,
    /// Data are too old: their age.
    #[event("ctl", unit = "s")]
    lost: Event<f64>,
    /// They come again: how long they were lost.
    #[event("ctl", unit = "s")]
    found: Event<f64>,
    /// Age of the newest sample; since Start when none came.
    #[state]
    #[unit("s")]
    age_s: f64,
    #[state]
    alive: Flag,
    /// How often data were lost since Start.
    #[state]
    losses: u64,
    #[config]
    cfg: WatchdogConfig,
    #[host]
    host: Host,
    begun: Stamp,
    lost_at: Stamp,
}

#[provides("ctl")]
impl Watchdog {
    #[read]
    fn alive(s: &WatchdogState) -> Flag {
        s.alive
    }
}

impl Component for Watchdog {
    fn start(&mut self) -> Result {
        (self.losses, self.alive) = (0, Flag::TRUE);
        self.begun = self.host.now();
        Ok(())
    }

    fn step(&mut self, t: &Tick) -> Result {
        let newest = self.watched.latest().map_or(self.begun, |sample| sample.stamp().max(self.begun));
        self.age_s = t.now().seconds_since(newest);
        let alive = self.age_s <= self.cfg.timeout_s;
        if alive && !self.alive.get() {
            self.found.emit(t.now().seconds_since(self.lost_at));
        } else if !alive && self.alive.get() {
            self.lost_at = t.now();
            self.losses += 1;
            self.lost.emit(self.age_s);
            self.hold.send(());
        }
        self.alive = alive.into();
        Ok(())
    }
}
