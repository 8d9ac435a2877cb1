//! `Client`: writes a ramp to whatever server it is connected to and listens to its events.
//!
//! Invariant: nothing waits; a missing or slow server only shows in the counters.

use trocar_sdk::prelude::*;

/// Set points of one ramp, mm: 0 to this, then again.
const RAMP_END: i32 = 100;

#[derive(Config)]
pub(crate) struct ClientConfig {
    /// Whether the client writes on its own
    #[config(live, default = true)]
    enabled: bool,
}

/// Writes a ramp of set points, 1 mm per step; requires the interface `Required`.
#[derive(Component)]
#[component(name = "Client", rate_hz = 10)]
pub struct Client {
    /// Called once per ramp.
    #[required(interface = "Required", name = "Void")]
    void: Function,
    /// Takes the next set point.
    #[required(interface = "Required", name = "Write", unit = "mm")]
    write: Function<i32>,
    /// Reads the set point back.
    #[required(interface = "Required", name = "Read", unit = "mm")]
    read: Function<(), i32>,
    /// The set point written last.
    #[state]
    #[unit("mm")]
    written: i32,
    /// The set point read back last.
    #[state]
    #[unit("mm")]
    read_back: i32,
    /// The set point the server told last.
    #[state]
    #[unit("mm")]
    reached: i32,
    /// Events seen so far.
    #[state]
    events: u32,
    /// Writes that did not reach a server.
    #[state]
    refused: u32,
    #[config]
    cfg: ClientConfig,
}

#[handles("Required")]
impl Client {
    /// The server took a set point.
    #[on(name = "SetPointReached")]
    fn set_point_reached(&mut self, value: i32) {
        self.reached = value;
        self.events += 1;
    }

    /// The server's `Void` was called.
    #[on(name = "VoidCalled", optional)]
    fn void_called(&mut self) {
        self.events += 1;
    }
}

impl Component for Client {
    fn step(&mut self, _: &Tick) -> Result {
        if !self.cfg.enabled {
            return Ok(());
        }
        self.written = if self.written >= RAMP_END { 0 } else { self.written + 1 };
        if !self.write.send(self.written).is_ok() {
            self.refused += 1;
        }
        if self.written == 0 {
            self.void.send(());
        }
        // A read is served from the server's state row, so it may be called from a step.
        if let Ok(value) = self.read.call(()) {
            self.read_back = value;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use trocar_sdk::testing::Bench;

    #[test]
    fn a_ramp_is_written_one_millimetre_per_step_with_one_void_at_its_end() {
        let mut bench = Bench::<Client>::new("{}");
        bench.step(103);
        let written = bench.calls::<i32>("Write");
        assert_eq!(written[..3], [1, 2, 3]);
        assert_eq!(written[99..], [100, 0, 1, 2]);
        assert_eq!(bench.calls::<()>("Void").len(), 1);
    }

    #[test]
    fn a_disabled_client_writes_nothing() {
        let mut bench = Bench::<Client>::new(r#"{"enabled": false}"#);
        bench.step(10);
        assert!(bench.calls::<i32>("Write").is_empty());
    }

    #[test]
    fn what_the_server_answers_and_tells_is_in_the_state() {
        let mut bench = Bench::<Client>::new("{}");
        bench.answer("Read", |()| Ok(42));
        bench.step(1);
        bench.emit("SetPointReached", 7).unwrap();
        bench.emit("VoidCalled", ()).unwrap();
        let s = bench.state();
        assert_eq!((s.read_back, s.reached, s.events), (42, 7, 2));
    }

    #[test]
    fn a_cut_connection_is_counted_and_stops_nobody() {
        let mut bench = Bench::<Client>::new("{}");
        bench.connect_function("Write", false);
        bench.step(3);
        assert_eq!(bench.state().refused, 3);
    }
}
