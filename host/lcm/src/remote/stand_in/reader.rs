//! Stands in for the reader of an output that is here: takes its samples to the other machine.
//!
//! Invariant: samples are taken as fast as the line carries them, newest or in order as the connection's
//! queue says; what the line does not carry in time is dropped in that queue, whole and counted.

use std::os::fd::OwnedFd;
use std::sync::Arc;

use parking_lot::Mutex;
use trocar_lcm_api::LinkDetail;
use trocar_net::line::{Clock, Outbox};
use trocar_rt::pool::PoolFile;
use trocar_rt::segment::{Agreed, Stream, StreamShape};
use trocar_rt::stream::{Payload, RemotePools, RemoteViews, StreamReader};

use super::codec::{message, put, put_short};
use super::writer::MOST_FRAME;
use super::{Kind, Link, StandIn, Take};

/// Bytes after which others of the line have their turn.
const AT_ONCE: usize = 256 << 10;

pub(super) struct AbsentReader {
    frames: bool,
    pools: Arc<RemotePools>,
    views: Arc<RemoteViews>,
    end: Mutex<End>,
}

struct End {
    stream: Stream<StreamReader>,
    takes: Takes,
    /// Number of pools that are known here.
    known: usize,
    /// Frames that no message holds.
    too_long: u64,
}

/// Whether samples are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Takes {
    /// Not before the other end is there.
    NotYet,
    Samples,
    /// The connection is cut: never again.
    Nothing,
}

impl AbsentReader {
    pub(super) fn open(
        memory: OwnedFd,
        shape: StreamShape,
        agreed: Agreed,
        (pools, views): (Arc<RemotePools>, Arc<RemoteViews>),
    ) -> Result<AbsentReader, String> {
        let stream =
            Stream::<StreamReader>::open(memory, shape, agreed, &views).map_err(|e| e.to_string())?;
        let end = Mutex::new(End { stream, takes: Takes::NotYet, known: 0, too_long: 0 });
        Ok(AbsentReader { frames: shape.payload == Payload::Frame, pools, views, end })
    }

    /// Maps the pools whose frames may come.
    fn know_pools(&self, known: &mut usize) {
        while let Some(number) = self.pools.at(*known) {
            // A pool that is gone already has no frames that could come.
            if let Some(file) = PoolFile::numbered(number) {
                // Out of files or of addresses: the next look may find some.
                let Ok(fd) = file.fd().try_clone_to_owned() else { break };
                let Ok(view) = PoolFile::open(fd, file.shape()) else { break };
                self.views.know(*known, view);
            }
            *known += 1;
        }
    }
}

impl StandIn for AbsentReader {
    fn came(&self, kind: Kind, _: Take<'_>, _: &Clock) -> Result<(), String> {
        match kind {
            Kind::Ready => {
                let takes = &mut self.end.lock().takes;
                if *takes == Takes::NotYet {
                    *takes = Takes::Samples;
                }
            }
            // Nobody comes to take its samples.
            Kind::Left => {}
            other => return Err(format!("{other:?} of a reader")),
        }
        Ok(())
    }

    fn fill(&self, link: Link, out: &mut Outbox) -> bool {
        let mut end = self.end.lock();
        let End { stream, takes, known, too_long } = &mut *end;
        if *takes != Takes::Samples {
            return false;
        }
        self.know_pools(known);
        let until = out.len() + AT_ONCE;
        while out.len() < until {
            let Some(sample) = stream.end.next() else { return false };
            if sample.data.len() + sample.bytes.len() > MOST_FRAME {
                *too_long += 1;
                stream.end.release();
                continue;
            }
            let kind = if self.frames { Kind::Frame } else { Kind::Sample };
            message(out, link, kind, |content| {
                put(content, [sample.meta.seq, sample.meta.stamp_ns, sample.meta.came_ns]);
                if self.frames {
                    put_short(content, [sample.data.len() as u32]);
                }
                content.extend_from_slice(sample.data);
                content.extend_from_slice(sample.bytes);
            });
            if self.frames {
                // Its slot is free again at once.
                stream.end.release();
            }
        }
        true
    }

    fn halt(&self) {
        self.end.lock().takes = Takes::Nothing;
    }

    fn correct(&self, detail: &mut LinkDetail) {
        // The reader's own end tells of the samples it has seen.
        (detail.passed, detail.bytes) = (0, 0);
        let End { stream, takes, too_long, .. } = &*self.end.lock();
        detail.dropped += too_long;
        let stats = stream.end.stats();
        // Samples that still wait are lost with the writer, or where nobody takes them any more.
        let is_open = *takes != Takes::Nothing && stream.end.has_writer();
        let waits = if is_open { stats.pushed.saturating_sub(stats.dropped) } else { 0 };
        detail.sent = stats.taken.max(waits).saturating_sub(*too_long);
    }
}
