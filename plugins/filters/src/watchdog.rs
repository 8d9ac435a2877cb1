//! Watches whether data still come, and lets a device hold if they do not.
//!
//! Invariant: data are alive only after a sample since Start or Resume, and only as long as the newest one is
//! young. Lost and found are told once each, in turn. The device is told to hold when data are lost, and
//! again and again while they are.
use trocar_sdk::prelude::*;

#[derive(Config)]
struct WatchdogConfig {
    /// Age of the newest sample at which the data count as lost
    #[config(live, min = 0.0001, max = 3600.0, unit = "s", default = 0.05)]
    timeout_s: f64,
    /// Interval at which the device is told to hold while data are lost: one that did not hear it, or came
    /// later, then does
    #[config(live, min = 0.001, max = 3600.0, unit = "s", default = 0.1)]
    repeat_s: f64,
}

/// Tells when samples of any type are too old, and calls `hold` of the connected component.
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
    /// Whether data come; false before the first ones.
    #[state]
    alive: Flag,
    /// Whether they are lost; false while the first ones are waited for, no longer than `timeout_s`.
    #[state]
    data_lost: Flag,
    /// Number of times data were lost since Start.
    #[state]
    losses: u64,
    /// Number of times the device was told to hold since Start.
    #[state]
    holds: u64,
    #[config]
    cfg: WatchdogConfig,
    #[host]
    host: Host,
    begun: Stamp,
    /// Stamp of the newest sample; none before the first one.
    newest: Option<Stamp>,
    lost_at: Stamp,
    held_at: Stamp,
}

#[provides("ctl")]
impl Watchdog {
    /// Whether data come.
    #[read]
    fn alive(s: &WatchdogState) -> Flag {
        s.alive
    }
}

impl Component for Watchdog {
    fn start(&mut self) -> Result {
        (self.losses, self.holds) = (0, 0);
        self.resume()
    }

    fn resume(&mut self) -> Result {
        (self.alive, self.data_lost) = (Flag::FALSE, Flag::FALSE);
        (self.begun, self.newest) = (self.host.now(), None);
        Ok(())
    }

    fn step(&mut self, t: &Tick) -> Result {
        let now = t.now();
        // A sample from before Start tells nothing; a stamp from far ahead would let the data live for ever.
        let come = self.watched.latest().map(|sample| sample.stamp());
        let timeout_s = self.cfg.timeout_s;
        self.newest = come.filter(|s| *s >= self.begun && !s.is_ahead_of(now, timeout_s)).or(self.newest);
        self.age_s = now.seconds_since(self.newest.unwrap_or(self.begun)).max(0.0);
        let too_old = self.age_s > timeout_s;
        if too_old && !self.data_lost.get() {
            (self.lost_at, self.losses) = (now, self.losses + 1);
            self.lost.emit(self.age_s);
            self.say_hold(now);
        } else if too_old && now.seconds_since(self.held_at) >= self.cfg.repeat_s {
            self.say_hold(now);
        } else if !too_old && self.data_lost.get() {
            self.found.emit(now.seconds_since(self.lost_at));
        }
        self.data_lost = too_old.into();
        self.alive = (!too_old && self.newest.is_some()).into();
        Ok(())
    }
}

impl Watchdog {
    fn say_hold(&mut self, now: Stamp) {
        self.held_at = now;
        self.holds += 1;
        self.hold.send(());
    }
}
