//! The two threads of a line while it lives.
//!
//! Invariant: a line ends when nothing was heard for [`SILENT_NS`] in which this process itself ran: a thread
//! that got no processor judges nobody.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use trocar_rt::house;
use trocar_rt::os::now_ns;

use super::greeting::{BEAT, beat_in, put_beat};
use super::wire::{Came, Inbox, MOST_BYTES, Outbox, is_nothing};
use super::{Line, Traffic};
use crate::revoked::Revoked;

/// Distance of two beats, ns.
const BEAT_NS: u64 = 10_000_000;
/// Silence after which a line is lost, ns.
pub(super) const SILENT_NS: u64 = 100_000_000;
/// Time between two looks at the list of revoked certificates, ns.
const JUDGED_NS: u64 = 50_000_000;
/// Time in which the other end takes no byte, after which a line is lost.
const STALLED: Duration = Duration::from_secs(1);
/// Bytes of one read.
const ROOM: usize = 128 << 10;

/// Runs a line on this thread until it is lost; another one sends.
pub(super) fn run(line: &Arc<Line>, traffic: &Arc<dyn Traffic>, inbox: Inbox, revoked: Option<Arc<Revoked>>) {
    let sends = (line.clone(), traffic.clone());
    let thread = std::thread::Builder::new().name("trocar-line-out".into());
    match house::spawn(thread, move || send(&sends.0, &*sends.1)) {
        Err(e) => line.end(&format!("this process gets no thread for it: {e}")),
        Ok(thread) => {
            let why = receive(line, &**traffic, inbox, revoked.as_deref());
            line.end(&why);
            if thread.join().is_err() {
                log::error!("the thread that sends to {} panicked", line.who.process);
            }
        }
    }
}

/// Receives until the line is over; returns why.
fn receive(line: &Line, traffic: &dyn Traffic, mut inbox: Inbox, revoked: Option<&Revoked>) -> String {
    let mut room = vec![0; ROOM];
    if let Err(e) = line.wire.wait_for(Duration::from_nanos(BEAT_NS), STALLED) {
        return e.to_string();
    }
    let (mut heard_ns, mut looked_ns, mut judged_ns) = (now_ns(), now_ns(), now_ns());
    loop {
        if let Err(why) = handle(line, traffic, &mut inbox) {
            return format!("it said what it may not: {why}");
        }
        let came = line.wire.receive(&mut room, &mut inbox);
        if line.is_lost() {
            return "ended from here".into();
        }
        let now = now_ns();
        if now >= judged_ns + JUDGED_NS {
            judged_ns = now;
            if revoked.is_some_and(|list| is_revoked(list, line)) {
                return "its certificate was revoked".into();
            }
        }
        // Time this thread did not run does not count as silence.
        heard_ns += (now - looked_ns).saturating_sub(2 * BEAT_NS);
        looked_ns = now;
        match came {
            Ok(Came::Bytes) => heard_ns = now,
            Ok(Came::End) => return "it ended or closed the connection".into(),
            Ok(Came::Nothing) => {
                let silent_ns = now.saturating_sub(heard_ns);
                if silent_ns > SILENT_NS {
                    return format!("nothing was heard of it for {} ms", silent_ns / 1_000_000);
                }
            }
            Err(why) => return why,
        }
    }
}

/// Handles the messages that are complete.
fn handle(line: &Line, traffic: &dyn Traffic, inbox: &mut Inbox) -> Result<(), String> {
    while let Some((kind, content)) = inbox.next(MOST_BYTES)? {
        match kind {
            BEAT => line.clock.heard(beat_in(content)?, now_ns()),
            kind => traffic.came(kind, content)?,
        }
    }
    Ok(())
}

fn is_revoked(list: &Revoked, line: &Line) -> bool {
    list.look();
    list.has(&line.holder.serial)
}

fn send(line: &Line, traffic: &dyn Traffic) {
    let mut out = Outbox::default();
    let mut next_ns = now_ns();
    let mut more = false;
    while !line.lost.load(Ordering::Acquire) {
        let now = now_ns();
        if now >= next_ns {
            next_ns = now + BEAT_NS;
            put_beat(&mut out, line.clock.beat(now));
        } else if !more {
            line.bell.wait(Some(next_ns));
        }
        for (kind, content) in line.take_said() {
            out.message(kind, |bytes| bytes.extend_from_slice(&content));
        }
        more = traffic.fill(&mut out);
        if out.is_empty() {
            continue;
        }
        if let Err(e) = line.wire.send(out.bytes()) {
            let why = match is_nothing(&e) {
                true => "it takes nothing any more".to_owned(),
                false => format!("it ended or closed the connection ({e})"),
            };
            return line.end(&why);
        }
        out.clear();
    }
}

impl Line {
    fn take_said(&self) -> impl Iterator<Item = (u8, Vec<u8>)> + use<> {
        let mut said = self.said.lock();
        said.bytes = 0;
        std::mem::take(&mut said.all).into_iter()
    }
}
