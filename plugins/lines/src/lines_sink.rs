//! `lines_sink`: what its inputs bring as lines for a program, for datagrams, a serial line or a file.
//!
//! Invariant: the step copies and never waits; a reader that is slower than the samples loses lines, which
//! are counted, and holds up nobody.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use trocar_imaging::waits::Again;
use trocar_sdk::data::{OperatingMode, OperatingState};
use trocar_sdk::prelude::*;
use trocar_sdk::{AnyType, RateLimit};

use crate::goal::Goal;
use crate::plan::Format;
use crate::writer::{Notice, Row, Types, Writer};

/// Most inputs.
const INPUTS: usize = 64;
/// Samples of the first input that are looked at in one step.
const AT_ONCE: usize = 1024;

#[derive(Config)]
struct LinesSinkConfig {
    /// Names of the inputs, of any type. Each sample of the first one is a line, with the newest of the
    /// others; lines begin when all have brought one
    #[config(default = ["in"])]
    inputs: Vec<String>,
    /// Numbers apart by commas, below a comment that names them, or an object of JSON each; the time comes
    /// first, in s
    #[config(one_of = ["numbers", "json"], default = "numbers")]
    format: String,
    /// Whether the comment with names and units stands before the numbers
    #[config(default = true)]
    header: bool,
    /// Program and arguments, one by one, which reads the lines; no shell looks at them. What it prints is
    /// not kept
    #[config(default = [])]
    program: Vec<String>,
    /// Address and port that each line is sent to, 127.0.0.1:9000
    #[config(default = "")]
    udp: String,
    /// A serial line, /dev/ttyUSB0; 8 bits, no parity, 1 stop bit
    #[config(default = "")]
    serial: String,
    /// Speed of the serial line
    #[config(min = 50, max = 4000000, unit = "Bd", default = 115200)]
    baud: u32,
    /// A file that is made; where there is one already, nothing is written over
    #[config(default = "")]
    file: String,
    /// At most so many samples of the first input are written per second; 0: all
    #[config(min = 0.0, max = 1000000.0, unit = "Hz", default = 0.0)]
    max_rate_hz: f64,
    /// Lines that wait to be written at most
    #[config(min = 1, max = 65536, default = 1024)]
    queue: u32,
    /// Whether a program is run again, and what failed opened again
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
pub struct Given {
    pub written: u64,
    /// Not written: the other side reads too slowly, or is not there.
    pub dropped: u64,
    /// Left out, as `max_rate_hz` says.
    pub left_out: u64,
    /// Not written, since another input had brought nothing yet.
    pub incomplete: u64,
    /// Times that the other side ended or failed.
    pub failures: u64,
}

/// Writes what its inputs bring as lines: to a program, as datagrams, over a serial line, to a file.
#[derive(Component)]
#[component(rate_hz = 100, starts_programs, hardware, max_step_ms = 1000, provides("sink"))]
pub struct LinesSink {
    /// The samples that are written
    #[input(name = "{}", fifo = 1024, optional)]
    inputs: Many<AnyIn>,
    /// The other side fails or takes lines again, and why.
    #[event("sink", name = "operating_state")]
    changed: Event<OperatingState>,
    #[state]
    given: Given,
    #[state]
    operating_state: OperatingState,
    /// After the other side failed: how long after that it is opened again; 0 while it runs, or where it is
    /// not.
    #[state]
    #[unit("s")]
    restart_in_s: f64,
    #[config]
    cfg: LinesSinkConfig,
    #[host]
    host: Host,
    rate: RateLimit,
    writer: Option<Writer>,
    before: Given,
    /// Dropped by the step.
    no_buffer: u64,
    /// The connection each input's last sample came by, and its type.
    known: Vec<(u64, Option<AnyType>)>,
    /// The newest value of each but the first; empty before it brought one.
    newest: Vec<Vec<u8>>,
    /// They are others than the writer knows.
    changed_types: bool,
    /// The last line that went out is not whole.
    cut: bool,
    /// The file that this component has made.
    made: Option<PathBuf>,
}

/// State of the lines.
#[provides("sink")]
impl LinesSink {
    /// Lines since Start.
    #[read]
    fn given(s: &LinesSinkState) -> Given {
        s.given
    }

    /// ENABLED while lines are taken, FAULT with the reason while the other side fails, DISABLED otherwise.
    #[read]
    fn operating_state(s: &LinesSinkState) -> OperatingState {
        s.operating_state
    }
}

impl LinesSink {
    fn goal(&self) -> Result<Goal> {
        let cfg = &self.cfg;
        let given =
            [!cfg.program.is_empty(), !cfg.udp.is_empty(), !cfg.serial.is_empty(), !cfg.file.is_empty()];
        if given.iter().filter(|given| **given).count() != 1 {
            return Err("program, udp, serial, file: give exactly one of them: where the lines go".into());
        }
        if given[0] {
            return match cfg.program[0].as_str() {
                "" => {
                    Err("program: is empty; name a program and its arguments, [\"python3\", \"show.py\"]"
                        .into())
                }
                _ => Ok(Goal::Program(cfg.program.clone())),
            };
        }
        if given[1] {
            let to: SocketAddr = cfg.udp.parse().map_err(|_| {
                format!("udp: {:?} is not an address and a port: write 127.0.0.1:9000", cfg.udp)
            })?;
            return Ok(Goal::Udp(to));
        }
        if given[2] {
            return Ok(Goal::Serial { port: cfg.serial.clone(), baud: cfg.baud });
        }
        let path = PathBuf::from(&cfg.file);
        let more = self.made.as_ref() == Some(&path);
        Ok(Goal::File { path, more })
    }

    fn again(&self) -> Result<Option<Again>> {
        Again::of(self.cfg.restart == "always", self.cfg.restart_delay_s, self.cfg.restart_delay_max_s)
    }

    fn open(&mut self) -> Result {
        self.writer = None;
        (self.restart_in_s, self.no_buffer, self.before) = (0.0, 0, self.given);
        self.changed_types = true;
        let goal = self.goal()?;
        let made = if let Goal::File { path, .. } = &goal { Some(path.clone()) } else { None };
        let format = if self.cfg.format == "json" { Format::Json } else { Format::Numbers };
        let (queue, again) = (self.cfg.queue as usize, self.again()?);
        let goes_on = !matches!(goal, Goal::File { more: false, .. });
        let how = (format, self.cfg.header, self.cut && goes_on);
        self.writer = Some(Writer::open(goal, how, queue, again, &self.host)?);
        self.cut = false;
        self.made = made.or(self.made.take());
        Ok(())
    }

    fn tell(&mut self, state: OperatingMode, message: Text<128>, now: Stamp) {
        self.operating_state =
            OperatingState { stamp: now, state, is_homed: true.into(), message, ..OperatingState::default() };
        self.changed.emit(self.operating_state);
    }

    fn count(&mut self) {
        let Some(writer) = &self.writer else { return };
        self.given.written = self.before.written + writer.counts.written.load(Relaxed);
        self.given.dropped = self.before.dropped + self.no_buffer + writer.lost();
        self.cut = writer.counts.cut.load(Relaxed);
    }

    /// Takes what the inputs but the first have brought; of one that is cut nothing is kept.
    fn gather(&mut self) {
        for at in 1..self.inputs.len() {
            for _ in 0..AT_ONCE {
                let Some(sample) = self.inputs.get_mut(at).and_then(|input| input.next()) else { break };
                let source = sample.source();
                if let Some(newest) = self.newest.get_mut(at) {
                    newest.clear();
                    newest.extend_from_slice(sample.value());
                }
                self.know(at, source);
            }
            let (Some(input), Some(newest)) = (self.inputs.get_mut(at), self.newest.get_mut(at)) else {
                break;
            };
            if newest.is_empty() {
                continue;
            }
            let Some(sample) = input.latest() else {
                newest.clear();
                continue;
            };
            // One that came just now counts as seen.
            newest.clear();
            newest.extend_from_slice(sample.value());
            let source = sample.source();
            self.know(at, source);
        }
    }

    /// One sample of the first input; false when there is none.
    fn line(&mut self) -> bool {
        let Some(sample) = self.inputs.get_mut(0).and_then(|first| first.next()) else { return false };
        let (stamp_ns, source) = (sample.stamp().ns(), sample.source());
        if !self.rate.is_due(stamp_ns) {
            self.given.left_out += 1;
            return true;
        }
        if self.newest.iter().skip(1).any(Vec::is_empty) {
            self.given.incomplete += 1;
            return true;
        }
        self.rate.keep(stamp_ns);
        let Some(mut bytes) = self.writer.as_mut().and_then(Writer::buffer) else {
            self.no_buffer += 1;
            return true;
        };
        bytes.extend_from_slice(sample.value());
        self.newest.iter().skip(1).for_each(|newest| bytes.extend_from_slice(newest));
        self.know(0, source);
        let types = if self.changed_types { self.types() } else { None };
        let Some(writer) = &mut self.writer else { return true };
        if self.changed_types && types.is_none() {
            // An input was cut just now, and has no type to tell.
            self.given.incomplete += 1;
            writer.keep(bytes);
            return true;
        }
        self.changed_types = false;
        writer.hand_on(Row { stamp_ns, bytes, types });
        true
    }

    /// Asks for the type of an input where its connection is another one. That allocates, once for each
    /// connection.
    fn know(&mut self, at: usize, source: u64) {
        let (Some(known), Some(input)) = (self.known.get_mut(at), self.inputs.get(at)) else { return };
        if known.0 != source || known.1.is_none() {
            *known = (source, input.ty());
            self.changed_types = true;
        }
    }

    fn types(&self) -> Option<Types> {
        let names = self.inputs.names().iter();
        let all = names.zip(&self.known).map(|(name, (_, ty))| Some((name.to_owned(), ty.clone()?)));
        all.collect::<Option<Vec<_>>>().map(Arc::new)
    }
}

impl Component for LinesSink {
    fn configure(&mut self) -> Result {
        let inputs = self.cfg.inputs.len();
        if !(1..=INPUTS).contains(&inputs) {
            return Err(format!("inputs: there are {inputs}, and 1 to {INPUTS} are possible").into());
        }
        self.goal()?;
        self.again()?;
        self.inputs.set(&self.cfg.inputs)
    }

    fn ports_changed(&mut self) {
        self.known = vec![(0, None); self.inputs.len()];
        self.newest = vec![Vec::new(); self.inputs.len()];
        self.changed_types = true;
    }

    fn start(&mut self) -> Result {
        self.given = Given::default();
        self.operating_state = OperatingState::default();
        self.rate = RateLimit::new(self.cfg.max_rate_hz);
        self.newest.iter_mut().for_each(Vec::clear);
        self.open()
    }

    fn resume(&mut self) -> Result {
        self.open()
    }

    fn stop(&mut self) -> Result {
        let ended = self.writer.as_mut().map_or(Ok(()), Writer::end);
        self.count();
        self.writer = None;
        self.restart_in_s = 0.0;
        self.tell(OperatingMode::DISABLED, Text::default(), self.host.now());
        ended
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let now = tick.now();
        while let Some(notice) = self.writer.as_mut().and_then(Writer::notice) {
            match notice {
                Notice::Runs => {
                    self.restart_in_s = 0.0;
                    self.tell(OperatingMode::ENABLED, Text::default(), now);
                }
                Notice::Failed(why, again_s) => {
                    self.given.failures += 1;
                    self.restart_in_s = again_s;
                    self.tell(OperatingMode::FAULT, why, now);
                }
            }
        }
        self.gather();
        for _ in 0..AT_ONCE {
            if !self.line() {
                break;
            }
        }
        self.count();
        Ok(())
    }
}

#[cfg(test)]
#[path = "lines_sink_tests.rs"]
mod tests;
