//! The threads of a line while it lives: one that receives and one that sends for each lane.
//!
//! Invariant: a line ends when nothing was heard on a lane for as long as the lane allows, and this process
//! itself ran in that time: a thread that got no processor judges nobody.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;
use std::time::Duration;

use trocar_rt::house;
use trocar_rt::os::now_ns;

use super::greeting::{BEAT, beat_in, put_beat};
use super::urgency::Urgency;
use super::wire::{Came, Inbox, MOST_BYTES, Outbox, is_nothing};
use super::{Lane, Line, Traffic};
use crate::revoked::Revoked;

/// Time between two looks at the list of revoked certificates, ns.
const JUDGED_NS: u64 = 50_000_000;
/// Bytes of one read.
const ROOM: usize = 128 << 10;

/// Runs a line until it is lost.
pub(super) fn run(
    line: &Arc<Line>,
    traffic: &Arc<dyn Traffic>,
    [prompt, bulk]: [Inbox; 2],
    revoked: Option<Arc<Revoked>>,
) {
    let lanes = [(Lane::Prompt, prompt, revoked), (Lane::Bulk, bulk, None)];
    let threads = lanes.map(|(lane, inbox, revoked)| {
        let (mine, its) = (line.clone(), traffic.clone());
        line.spawn(lane.threads()[0], move || serve(&mine, &its, lane, inbox, revoked.as_deref()))
    });
    threads.into_iter().for_each(|thread| line.join(thread));
}

/// Serves one lane until the line is lost.
fn serve(line: &Arc<Line>, traffic: &Arc<dyn Traffic>, lane: Lane, inbox: Inbox, revoked: Option<&Revoked>) {
    let (mine, its) = (line.clone(), traffic.clone());
    let sends = line.spawn(lane.threads()[1], move || send(&mine, &*its, lane));
    let why = receive(line, &**traffic, lane, inbox, revoked);
    line.end(&why);
    line.join(sends);
}

/// Receives on a lane until the line is over; returns why.
fn receive(
    line: &Line,
    traffic: &dyn Traffic,
    lane: Lane,
    mut inbox: Inbox,
    revoked: Option<&Revoked>,
) -> String {
    let mut urgency = Urgency::take(lane);
    let (wire, beat_ns) = (&line.track(lane).wire, lane.beat_ns());
    let mut room = vec![0; ROOM];
    wire.rank(lane.rank(line.most_rate));
    if let Err(e) = wire.wait_for(Duration::from_nanos(beat_ns), lane.stalled()) {
        return e.to_string();
    }
    let (mut heard_ns, mut looked_ns, mut judged_ns) = (now_ns(), now_ns(), now_ns());
    loop {
        if let Err(why) = handle(line, traffic, lane, &mut inbox) {
            return format!("it said what it may not: {why}");
        }
        let came = wire.receive(&mut room, &mut inbox);
        if line.is_lost() {
            return "ended from here".into();
        }
        let now = now_ns();
        urgency.look(now);
        if now >= judged_ns + JUDGED_NS {
            judged_ns = now;
            if revoked.is_some_and(|list| is_revoked(list, line)) {
                return "its certificate was revoked".into();
            }
        }
        // Time this thread did not run does not count as silence.
        heard_ns += (now - looked_ns).saturating_sub(2 * beat_ns);
        looked_ns = now;
        match came {
            Ok(Came::Bytes) => heard_ns = now,
            Ok(Came::End) => return "it ended or closed the connection".into(),
            Ok(Came::Nothing) => {
                let silent_ns = now.saturating_sub(heard_ns);
                if silent_ns > lane.silent_ns() {
                    return format!("nothing was heard of it for {} ms", silent_ns / 1_000_000);
                }
            }
            Err(why) => return why,
        }
    }
}

/// Handles the messages that are complete.
fn handle(line: &Line, traffic: &dyn Traffic, lane: Lane, inbox: &mut Inbox) -> Result<(), String> {
    while let Some((kind, content)) = inbox.next(MOST_BYTES)? {
        match kind {
            // The prompt lane alone tells of the clock.
            BEAT => {
                let beat = beat_in(content)?;
                if lane == Lane::Prompt {
                    line.clock.heard(beat, now_ns());
                }
            }
            kind => traffic.came(lane, kind, content)?,
        }
    }
    Ok(())
}

fn is_revoked(list: &Revoked, line: &Line) -> bool {
    list.look();
    list.has(&line.holder.serial)
}

fn send(line: &Line, traffic: &dyn Traffic, lane: Lane) {
    let mut urgency = Urgency::take(lane);
    let track = line.track(lane);
    let mut out = Outbox::default();
    let mut next_ns = now_ns();
    let mut more = false;
    while !line.lost.load(Ordering::Acquire) {
        let now = now_ns();
        urgency.look(now);
        if now >= next_ns {
            next_ns = now + lane.beat_ns();
            put_beat(&mut out, line.clock.beat(now));
        } else if !more {
            track.bell.wait(Some(next_ns));
        }
        if lane == Lane::Prompt {
            for (kind, content) in line.take_said() {
                out.message(kind, |bytes| bytes.extend_from_slice(&content));
            }
        }
        more = traffic.fill(lane, &mut out);
        if out.is_empty() {
            continue;
        }
        if let Err(e) = track.wire.send(out.bytes()) {
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
    /// Starts a thread of this line; without one the line ends.
    fn spawn(self: &Arc<Line>, name: &str, run: impl FnOnce() + Send + 'static) -> Option<JoinHandle<()>> {
        let thread = house::spawn(std::thread::Builder::new().name(name.into()), run);
        thread.inspect_err(|e| self.end(&format!("this process gets no thread for it: {e}"))).ok()
    }

    fn join(&self, thread: Option<JoinHandle<()>>) {
        if thread.is_some_and(|thread| thread.join().is_err()) {
            log::error!("a thread of the line with {} panicked", self.who.process);
        }
    }

    fn take_said(&self) -> impl Iterator<Item = (u8, Vec<u8>)> + use<> {
        let mut said = self.said.lock();
        said.bytes = 0;
        std::mem::take(&mut said.all).into_iter()
    }
}
