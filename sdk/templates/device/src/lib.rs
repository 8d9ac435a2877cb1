//! A sensor on a byte stream, such as a serial line: change what a line means in `reader.rs`, and what is
//! made of it here.
#![forbid(unsafe_code)]

mod reader;

use reader::Reader;
use trocar_sdk::data::Scalar;
use trocar_sdk::prelude::*;

/// Values that one step takes at most, so that its time has a bound.
const AT_ONCE: usize = 64;

/// The settings.
#[derive(Config)]
struct Settings {
    /// Address of the device, host:port; empty: a simulated one
    #[config(default = "")]
    address: String,
    /// Without a value for so long the device counts as silent
    #[config(live, min = 0.02, max = 60.0, unit = "s", default = 0.2)]
    silent_s: f64,
}

/// Hands on the values of the device, and tells when it falls silent.
#[derive(Component)]
#[component(
    name = "{{crate}}",
    rate_hz = 100,
    safety = "sensor",
    hardware,
    provides("sensor")
)]
struct {{Name}} {
    /// Each value, with the time at which its line came
    #[output]
    value: Out<Scalar>,
    /// True: the device answers again. False: it is silent.
    #[event("sensor")]
    answers: Event<Flag>,
    /// The latest value; stamp 0 while the device is silent, so that nobody takes an old value for a new one.
    #[state]
    latest: Scalar,
    #[config]
    settings: Settings,
    #[host]
    host: Host,
    /// The thread that talks to the device, from Start to Stop.
    reader: Option<Reader>,
}

/// The reads that others may call.
#[provides("sensor")]
impl {{Name}} {
    /// The latest value; stamp 0 while the device is silent.
    #[read]
    fn latest(s: &{{Name}}State) -> Scalar {
        s.latest
    }
}

impl Component for {{Name}} {
    fn start(&mut self) -> Result {
        self.latest = Scalar::default();
        // A device that is not there yet is no error: the reader tries again until Stop.
        self.reader = Some(Reader::start(&self.settings.address, &self.host));
        Ok(())
    }

    fn stop(&mut self) -> Result {
        self.reader = None; // Ends its thread.
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let answered = self.latest.stamp.is_valid();
        for value in self.reader.iter().flat_map(Reader::values).take(AT_ONCE) {
            self.latest = value;
            self.value.write(&value);
        }
        if tick.now().seconds_since(self.latest.stamp) > self.settings.silent_s {
            self.latest.stamp = Stamp::INVALID;
        }
        let answers = self.latest.stamp.is_valid();
        if answers != answered {
            self.answers.emit(answers.into());
        }
        Ok(())
    }
}

trocar_plugin!({{Name}});

#[cfg(test)]
mod tests;
