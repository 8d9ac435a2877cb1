//! `lines_source`: the lines of a program, of datagrams or of a serial line as typed outputs.
//!
//! Invariant: a line is taken whole or not at all; a bad one is counted and shown, and ends nothing. The step
//! only hands on.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use trocar_imaging::waits::Again;
use trocar_sdk::data::{OperatingMode, OperatingState};
use trocar_sdk::prelude::*;

use crate::plan::{Format, Plan};
use crate::reader::{Notice, Reader};
use crate::way::Origin;

#[derive(Config)]
struct LinesSourceConfig {
    /// One text for each output: "force: fx N, fy N", "tip: Pose", "value: f64". A field is NAME[n] TYPE UNIT
    /// = FROM, of which the name is enough; TYPE is f64, f32, i64, i32, u64, u32, bool or text, FROM a column
    /// or a path of JSON. Payloads: Scalar, Message, Pose, Twist, Wrench, JointState[n]
    outputs: Vec<String>,
    /// The form of a line: numbers apart by `;`, `,`, tabs or blanks, or an object of JSON each. Lines that
    /// begin with # are passed over
    #[config(one_of = ["numbers", "json"], default = "numbers")]
    format: String,
    /// Program and arguments, one by one, whose output is read; no shell looks at them
    #[config(default = [])]
    program: Vec<String>,
    /// Address and port at which datagrams are taken, 127.0.0.1:9000; a datagram is one line or several
    #[config(default = "")]
    udp: String,
    /// Take datagrams at an address that other machines reach: whoever can send there decides what the
    /// outputs say
    #[config(default = false)]
    udp_from_network: bool,
    /// A serial line, /dev/ttyUSB0; 8 bits, no parity, 1 stop bit
    #[config(default = "")]
    serial: String,
    /// Speed of the serial line
    #[config(min = 50, max = 4000000, unit = "Bd", default = 115200)]
    baud: u32,
    /// Stamps of the samples: "arrival", or a field of the line with the device's own time and its unit, "t
    /// ms"; of numbers, the column, "1 ms"
    #[config(default = "arrival")]
    stamp: String,
    /// Numbers in a line; 0: as many as outputs and stamp take
    #[config(max = 4096, default = 0)]
    columns: u32,
    /// Lines that are handed on in one step at most; of more, the newest
    #[config(min = 1, max = 4096, default = 256)]
    queue: u32,
    /// Without a good line for so long, `stale` says so
    #[config(min = 0.01, max = 3600.0, unit = "s", default = 1.0)]
    stale_s: f64,
    /// Whether the source is opened again when it ended or failed
    #[config(one_of = ["always", "never"], default = "always")]
    restart: String,
    /// Time from a failure to that; each time twice as long, until it ran for longer than that
    #[config(min = 0.01, max = 3600.0, unit = "s", default = 1.0)]
    restart_delay_s: f64,
    /// And never longer than this
    #[config(min = 0.01, max = 3600.0, unit = "s", default = 30.0)]
    restart_delay_max_s: f64,
}

/// Lines since Start.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Taken {
    /// Read, without empty ones and comments.
    pub lines: u64,
    /// Handed on.
    pub handed_on: u64,
    /// Not taken: no number, too many, out of range, no text, too long, cut.
    pub bad: u64,
    /// Good ones that came faster than the steps took them.
    pub dropped: u64,
    /// Times that the source ended or failed.
    pub failures: u64,
    /// Times that the device's clock went back or was set.
    pub clock_resets: u64,
}

/// A line that was not taken.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct BadLine {
    pub stamp: Stamp,
    /// All since Start.
    pub bad: u64,
    /// Its number, why it was not taken, and how it begins.
    pub line: Text<256>,
}

/// Makes typed outputs of lines: numbers or JSON that a program prints, that come as datagrams or over a
/// serial line.
#[derive(Component)]
#[component(rate_hz = 250, safety = "sensor", hardware, starts_programs)]
pub struct LinesSource {
    /// One for each description in `outputs`, with the type that it says
    #[output]
    outputs: Many<AnyOut>,
    /// A line was not taken; at most one per second is told, each is counted.
    #[event("source")]
    bad_line: Event<BadLine>,
    /// The source fails or gives lines again, and why.
    #[event("source", name = "operating_state")]
    changed: Event<OperatingState>,
    #[state]
    taken: Taken,
    /// The bad line told last.
    #[state]
    last_bad: Text<256>,
    #[state]
    operating_state: OperatingState,
    /// Time since the last good line, or since Start.
    #[state]
    #[unit("s")]
    silent_s: f64,
    /// No good line came for `stale_s`.
    #[state]
    stale: Flag,
    /// After the source failed: how long after that it is opened again; 0 while it runs, or where it is not.
    #[state]
    #[unit("s")]
    restart_in_s: f64,
    /// Port at which datagrams are taken; 0 without one.
    #[state]
    udp_port: u32,
    #[config]
    cfg: LinesSourceConfig,
    #[host]
    host: Host,
    plan: Option<Arc<Plan>>,
    reader: Option<Reader>,
    /// When the last good line was handed on, or Start was.
    heard: Stamp,
    /// Counted by readers before this one.
    before: Taken,
}

/// State of the lines.
#[provides("source")]
impl LinesSource {
    /// Lines since Start.
    #[read]
    fn taken(s: &LinesSourceState) -> Taken {
        s.taken
    }

    /// The bad line told last; empty without one.
    #[read]
    fn last_bad(s: &LinesSourceState) -> Text<256> {
        s.last_bad
    }

    /// ENABLED while lines come, FAULT with the reason while the source fails, DISABLED otherwise.
    #[read]
    fn operating_state(s: &LinesSourceState) -> OperatingState {
        s.operating_state
    }
}

impl LinesSource {
    fn origin(&self) -> Result<Origin> {
        let cfg = &self.cfg;
        let given = [!cfg.program.is_empty(), !cfg.udp.is_empty(), !cfg.serial.is_empty()];
        if given.iter().filter(|given| **given).count() != 1 {
            return Err("program, udp, serial: give exactly one of them: where the lines come from".into());
        }
        if given[0] {
            return match cfg.program[0].as_str() {
                "" => {
                    Err("program: is empty; name a program and its arguments, [\"python3\", \"sensor.py\"]"
                        .into())
                }
                _ => Ok(Origin::Program(cfg.program.clone())),
            };
        }
        if given[2] {
            return Ok(Origin::Serial { port: cfg.serial.clone(), baud: cfg.baud });
        }
        Ok(Origin::Udp(address(&cfg.udp, cfg.udp_from_network)?))
    }

    fn again(&self) -> Result<Option<Again>> {
        Again::of(self.cfg.restart == "always", self.cfg.restart_delay_s, self.cfg.restart_delay_max_s)
    }

    fn open(&mut self) -> Result {
        self.reader = None;
        self.restart_in_s = 0.0;
        self.before = self.taken;
        self.heard = self.host.now();
        let Some(plan) = self.plan.clone() else { return Ok(()) };
        let queue = self.cfg.queue as usize;
        self.reader = Some(Reader::open(self.origin()?, plan, queue, self.again()?, self.host.clone())?);
        Ok(())
    }

    fn tell(&mut self, state: OperatingMode, message: Text<128>, now: Stamp) {
        self.operating_state =
            OperatingState { stamp: now, state, is_homed: true.into(), message, ..OperatingState::default() };
        self.changed.emit(self.operating_state);
    }

    fn count(&mut self) {
        let Some(reader) = &self.reader else { return };
        let (counts, before) = (&reader.counts, &self.before);
        self.taken.lines = before.lines + counts.lines.load(Relaxed);
        self.taken.bad = before.bad + counts.bad.load(Relaxed);
        self.taken.dropped = before.dropped + counts.dropped.load(Relaxed);
        self.taken.clock_resets = before.clock_resets + counts.clock_resets.load(Relaxed);
        self.udp_port = counts.udp_port.load(Relaxed) as u32;
    }
}

/// The address of `udp`; one that other machines reach only where that is said.
fn address(text: &str, from_network: bool) -> Result<SocketAddr> {
    let address: SocketAddr = text
        .parse()
        .map_err(|_| format!("udp: {text:?} is not an address and a port: write 127.0.0.1:9000"))?;
    if address.ip().is_loopback() || from_network {
        return Ok(address);
    }
    Err(format!(
        "udp: other machines reach {address}, and any sender there decides what the outputs say: write 127.0.0.1:{}, or say \
         \"udp_from_network\": true",
        address.port()
    )
    .into())
}

impl Component for LinesSource {
    fn configure(&mut self) -> Result {
        let format = if self.cfg.format == "json" { Format::Json } else { Format::Numbers };
        let plan = Plan::of(&self.cfg.outputs, format, &self.cfg.stamp, self.cfg.columns as usize)?;
        self.origin()?;
        self.again()?;
        self.outputs.set_typed(plan.outputs.iter().map(|output| (&output.name, output.ty.clone())))?;
        self.plan = Some(Arc::new(plan));
        Ok(())
    }

    fn start(&mut self) -> Result {
        self.taken = Taken::default();
        self.last_bad = Text::default();
        self.operating_state = OperatingState::default();
        self.open()
    }

    fn resume(&mut self) -> Result {
        self.open()
    }

    fn stop(&mut self) -> Result {
        let ended = self.reader.as_mut().map_or(Ok(()), Reader::end);
        self.count();
        // Records that were still on their way are not handed on any more.
        self.taken.dropped = self.taken.lines.saturating_sub(self.taken.bad + self.taken.handed_on);
        self.reader = None;
        self.restart_in_s = 0.0;
        self.tell(OperatingMode::DISABLED, Text::default(), self.host.now());
        ended
    }

    fn make_safe(&mut self) -> Result {
        if let Some(reader) = &self.reader {
            reader.halt();
        }
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let now = tick.now();
        self.count();
        // As many as wait in a reader at most.
        while let Some(notice) = self.reader.as_mut().and_then(Reader::notice) {
            match notice {
                Notice::Runs => {
                    self.restart_in_s = 0.0;
                    self.tell(OperatingMode::ENABLED, Text::default(), now);
                }
                Notice::Failed(why, again_s) => {
                    self.taken.failures += 1;
                    self.restart_in_s = again_s;
                    self.tell(OperatingMode::FAULT, why, now);
                }
                Notice::Bad(line) => {
                    self.last_bad = line;
                    self.bad_line.emit(BadLine { stamp: now, bad: self.taken.bad, line });
                }
            }
        }
        for _ in 0..self.cfg.queue {
            let Some(shot) = self.reader.as_mut().and_then(Reader::next) else { break };
            if let Some(plan) = &self.plan {
                for (at, output) in self.outputs.ports().enumerate() {
                    let (Some(begin), Some(described)) = (plan.begins.get(at), plan.outputs.get(at)) else {
                        continue;
                    };
                    if let Some(value) = shot.record.get(*begin..begin + described.blank.len()) {
                        output.write_bytes(value, shot.stamp);
                    }
                }
            }
            self.taken.handed_on += 1;
            self.heard = now;
            if let Some(reader) = &mut self.reader {
                reader.give_back(shot.record);
            }
        }
        // A line that came in this step was perhaps not counted before.
        self.count();
        self.silent_s = now.seconds_since(self.heard).max(0.0);
        self.stale = (self.silent_s > self.cfg.stale_s).into();
        Ok(())
    }
}

#[cfg(test)]
#[path = "lines_source_tests.rs"]
mod tests;
