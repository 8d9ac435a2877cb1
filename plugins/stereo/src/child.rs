//! A child process that writes raw frames to its standard output, such as ffmpeg.
//!
//! Invariant: a child lives and dies by the rules of [`trocar_imaging::program`]; one that does not complete
//! a frame in time is ended.

use std::io::Read;
use std::os::fd::AsFd;
use std::process::ChildStdout;
use std::time::{Duration, Instant};

use trocar_imaging::program::{self, Running};

use crate::feed::{Giver, Source, Stop};

/// A program and its manners.
pub(crate) struct Program {
    /// Program and arguments; no shell looks at them.
    pub(crate) command: Vec<String>,
    /// A child that does not complete a frame for so long has stalled.
    pub(crate) stall: Duration,
    /// From exposure to the last byte of a frame, s.
    pub(crate) delay_s: f64,
}

impl Program {
    fn name(&self) -> &str {
        self.command.first().map_or("", String::as_str)
    }
}

impl Source for Program {
    type Session = Running<ChildStdout>;

    fn open(&self) -> Result<Running<ChildStdout>, String> {
        program::listened_to("command", &self.command)
    }

    fn pump(&self, mut running: Running<ChildStdout>, giver: &mut Giver, stop: &Stop) -> String {
        let (mut filled, mut frames) = (0, 0u64);
        let mut talks = true;
        // The time of the frame: a child that writes a byte now and then has stalled, too.
        let mut begun = Instant::now();
        loop {
            let left = self.stall.saturating_sub(begun.elapsed());
            if left.is_zero() {
                let (name, stall) = (self.name(), self.stall.as_secs_f64());
                let wrote = if filled == 0 { "nothing".into() } else { format!("{filled} B of a frame") };
                let end = match running.end() {
                    Ok(_) => "it was ended".into(),
                    Err(why) => why,
                };
                return format!("{name} stalled: it wrote {wrote} in {stall} s after {frames} frames; {end}");
            }
            let files = [running.way.as_fd(), running.err.as_fd()];
            let [out, err] = stop.poll(&files[..if talks { 2 } else { 1 }], left);
            if stop.is_set() {
                return String::new();
            }
            if err {
                talks = running.hear();
            }
            if !out {
                continue;
            }
            let room = giver.room().get_mut(filled..).unwrap_or_default();
            match running.way.read(room) {
                Ok(0) => break,
                Ok(more) => filled += more,
                Err(why) if why.kind() == std::io::ErrorKind::Interrupted => {}
                Err(why) => return format!("{}: its output cannot be read: {why}", self.name()),
            }
            if filled == giver.room().len() {
                giver.give(self.delay_s);
                (filled, frames, begun) = (0, frames + 1, Instant::now());
            }
        }
        // First ended: one that talks on and on is cut then.
        let status = running.ended();
        if talks {
            running.hear_out(stop);
        }
        let rest = if filled > 0 { format!(" and {filled} B of the next") } else { String::new() };
        let words = running.last_words();
        let name = self.name();
        match status {
            Ok(Some(status)) => format!("{name} ended ({status}) after {frames} frames{rest}{words}"),
            Ok(None) => format!("{name} closed its output after {frames} frames{rest}; it was ended{words}"),
            Err(why) => format!("{name} closed its output after {frames} frames{rest}; {why}{words}"),
        }
    }
}
