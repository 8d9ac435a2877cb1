//! `Server`: holds a set point and tells when it changes.
//!
//! Invariant: `Read` answers what `Write` took last; the event comes after the value is in the state.

use trocar_sdk::prelude::*;

/// Holds a set point; provides the interface `Provided`.
#[derive(Component)]
#[component(name = "Server")]
pub struct Server {
    /// A new set point was taken.
    #[event("Provided", name = "SetPointReached", unit = "mm")]
    set_point_reached: Event<i32>,
    /// `Void` was called.
    #[event("Provided", name = "VoidCalled")]
    void_called: Event,
    /// The set point.
    #[state]
    #[unit("mm")]
    set_point: i32,
    /// Calls of `Void` so far.
    #[state]
    void_calls: u64,
}

/// The example's interface.
#[provides("Provided")]
impl Server {
    /// Does nothing but being counted.
    #[command(name = "Void")]
    fn void(&mut self) {
        self.void_calls += 1;
        self.void_called.emit(());
    }

    /// Sets the set point.
    #[command(name = "Write")]
    fn write(&mut self, #[arg(unit = "mm", min = 0, max = 100, doc = "New set point")] value: i32) {
        self.set_point = value;
        self.set_point_reached.emit(value);
    }

    /// The set point.
    #[read(name = "Read", unit = "mm")]
    fn read(s: &ServerState) -> i32 {
        s.set_point
    }
}

impl Component for Server {
    fn start(&mut self) -> Result {
        (self.set_point, self.void_calls) = (0, 0);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use trocar_sdk::testing::Bench;

    #[test]
    fn read_answers_what_write_took_and_the_event_tells_it() {
        let mut bench = Bench::<Server>::new("{}");
        bench.command::<i32, ()>("Write", 30).unwrap();
        assert_eq!(bench.read::<(), i32>("Provided/Read", ()).unwrap(), 30);
        assert_eq!(bench.events::<i32>("SetPointReached"), [30]);
    }

    #[test]
    fn void_is_counted_and_told() {
        let mut bench = Bench::<Server>::new("{}");
        bench.command::<(), ()>("Void", ()).unwrap();
        bench.command::<(), ()>("Void", ()).unwrap();
        assert_eq!(bench.state().void_calls, 2);
        assert_eq!(bench.events::<()>("VoidCalled").len(), 2);
    }

    #[test]
    fn a_fresh_start_begins_at_zero() {
        let mut bench = Bench::<Server>::new("{}");
        bench.command::<i32, ()>("Write", 30).unwrap();
        bench.stop().unwrap();
        bench.start().unwrap();
        assert_eq!(bench.read::<(), i32>("Read", ()).unwrap(), 0);
    }
}
