//! The thread that writes lines, and the step's end of it.
//!
//! Invariant: the step hands on copies and never waits; what finds no buffer because the other side reads
//! slowly is counted by the step. The thread ends with its `Writer`; what it had in its hands then is written
//! if the other side takes it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use trocar_imaging::side::Side;
use trocar_imaging::waits::{Again, Stop};
use trocar_sdk::AnyType;
use trocar_sdk::prelude::*;

use crate::goal::{Goal, Open};
use crate::plan::Format;
use crate::spelled::Spelled;

/// Time between two looks for samples.
const LOOK: Duration = Duration::from_millis(5);
/// Words that wait for the step.
const NOTICES: usize = 8;
/// Bytes that are written at once.
const AT_ONCE: usize = 32_768;
/// Bytes of all buffers that are made before they are needed; more are made by the step as lines wait.
const MADE_BEFORE: usize = 16 << 20;

/// Names and types of the inputs, each time they are others.
pub(crate) type Types = Arc<Vec<(String, AnyType)>>;

/// The samples of one line.
pub(crate) struct Row {
    pub(crate) stamp_ns: u64,
    /// The values of all inputs, one after the other.
    pub(crate) bytes: Vec<u8>,
    /// Present when they are others than before.
    pub(crate) types: Option<Types>,
}

/// News for the step: lines go again, or why none go, and after how long the goal is opened again, s.
pub(crate) enum Notice {
    Runs,
    Failed(Text<128>, f64),
}

#[derive(Default)]
pub(crate) struct Counts {
    pub(crate) written: AtomicU64,
    /// Lines that nobody took.
    pub(crate) lost: AtomicU64,
    /// The last line that went out is not whole.
    pub(crate) cut: AtomicBool,
}

/// Buffers that there are, and may be at most.
struct Made {
    now: AtomicUsize,
    most: usize,
}

impl Made {
    /// Whether one more may be made; counts it.
    fn one_more(&self) -> bool {
        let next = |now| (now < self.most).then_some(now + 1);
        self.now.fetch_update(Ordering::Relaxed, Ordering::Relaxed, next).is_ok()
    }
}

/// The step's end.
pub(crate) struct Writer {
    rows: SyncSender<Row>,
    empty: Receiver<Vec<u8>>,
    /// A buffer that came back unused.
    kept: Option<Vec<u8>>,
    made: Arc<Made>,
    /// Rows that were handed on.
    handed_on: u64,
    notices: Receiver<Notice>,
    pub(crate) counts: Arc<Counts>,
    /// Lines are to be written to the end.
    finish: Arc<AtomicBool>,
    side: Side,
}

impl Writer {
    /// `cut`: the line before, of another writer to the same goal, is not whole.
    ///
    /// # Errors
    /// The goal cannot be opened.
    pub(crate) fn open(
        goal: Goal,
        (format, header, cut): (Format, bool, bool),
        queue: usize,
        again: Option<Again>,
        host: &Host,
    ) -> Result<Writer> {
        let open = goal.open()?;
        let (finish, counts) = (Arc::<AtomicBool>::default(), Arc::<Counts>::default());
        let (rows, rows_out) = sync_channel(queue);
        let (empty_in, empty) = sync_channel(queue);
        let (notices_in, notices) = sync_channel(NOTICES);
        counts.cut.store(cut, Ordering::Relaxed);
        let made = Arc::new(Made { now: AtomicUsize::new(0), most: queue });
        let mut thread = Thread {
            rows: rows_out,
            empty: empty_in,
            made: made.clone(),
            notices: notices_in,
            counts: counts.clone(),
            format,
            header,
            spelled: Spelled::default(),
            header_due: true,
            sizes: Vec::new(),
            total: 0,
            text: String::new(),
            ends: Vec::new(),
        };
        let finishing = finish.clone();
        let side = Side::begin(host, "lines", "that writes lines", move |stop| {
            thread.supervise(goal, open, stop, &finishing, again);
        })?;
        Ok(Writer { rows, empty, kept: None, made, handed_on: 0, notices, counts, finish, side })
    }

    /// A buffer for the next line; none while all are on their way.
    pub(crate) fn buffer(&mut self) -> Option<Vec<u8>> {
        let there = self.kept.take().or_else(|| self.empty.try_recv().ok());
        there.or_else(|| self.made.one_more().then(Vec::new))
    }

    /// Takes a buffer back that was not used.
    pub(crate) fn keep(&mut self, mut buffer: Vec<u8>) {
        buffer.clear();
        self.kept = Some(buffer);
    }

    pub(crate) fn hand_on(&mut self, row: Row) {
        // There is room for all buffers.
        let _ = self.rows.try_send(row);
        self.handed_on += 1;
    }

    /// Rows that were not written: so far, or after the end all of them.
    pub(crate) fn lost(&self) -> u64 {
        if self.side.is_owned() {
            return self.counts.lost.load(Ordering::Relaxed);
        }
        self.handed_on.saturating_sub(self.counts.written.load(Ordering::Relaxed))
    }

    pub(crate) fn notice(&mut self) -> Option<Notice> {
        self.notices.try_recv().ok()
    }

    /// Writes what is on its way as far as the other side takes it, for a moment, and ends the thread and the
    /// goal.
    ///
    /// # Errors
    /// The thread panicked.
    pub(crate) fn end(&mut self) -> Result {
        self.finish.store(true, Ordering::Release);
        let begun = Instant::now();
        while !self.side.is_finished() && begun.elapsed() < Duration::from_secs(1) {
            let _ = self.side.stop().poll(&[], LOOK);
        }
        self.side.end()
    }
}

/// The thread's end.
struct Thread {
    rows: Receiver<Row>,
    empty: SyncSender<Vec<u8>>,
    made: Arc<Made>,
    notices: SyncSender<Notice>,
    counts: Arc<Counts>,
    format: Format,
    header: bool,
    spelled: Spelled,
    /// The next line comes below a header.
    header_due: bool,
    /// Bytes of each input's value.
    sizes: Vec<usize>,
    /// Bytes of a row.
    total: usize,
    text: String,
    /// The end of each line in `text`.
    ends: Vec<usize>,
}

impl Thread {
    fn supervise(
        &mut self,
        mut goal: Goal,
        first: Open,
        stop: &Stop,
        finish: &AtomicBool,
        again: Option<Again>,
    ) {
        let (mut open, mut last, name) = (Some(first), None, goal.name());
        if let Goal::File { more, .. } = &mut goal {
            *more = true;
        }
        loop {
            let begun = Instant::now();
            let why = match open.take().map_or_else(|| goal.open(), Ok) {
                Ok(mut open) => {
                    let why = self.pump(&mut open, &name, stop, finish);
                    if open.close(stop) {
                        self.counts.cut.store(true, Ordering::Relaxed);
                    }
                    why
                }
                Err(why) => why,
            };
            if stop.is_set() || finish.load(Ordering::Acquire) {
                return;
            }
            let delay = again.map(|again| again.next(last, begun.elapsed()));
            last = delay;
            let again_s = delay.unwrap_or_default().as_secs_f64();
            let _ = self.notices.try_send(Notice::Failed(Text::new(&why), again_s));
            let begun = Instant::now();
            // Samples that come meanwhile are lost, and counted.
            while delay.is_none_or(|delay| begun.elapsed() < delay) {
                while let Some(row) = self.row() {
                    self.give_back(row);
                    self.counts.lost.fetch_add(1, Ordering::Relaxed);
                }
                if stop.is_set() || finish.load(Ordering::Acquire) {
                    return;
                }
                let _ = stop.poll(&[], LOOK);
            }
        }
    }

    /// Writes until the word to stop, the end of all lines, or a failure; gives the reason.
    fn pump(&mut self, open: &mut Open, name: &str, stop: &Stop, finish: &AtomicBool) -> String {
        let mut runs = false;
        self.header_due = true;
        loop {
            let last = finish.load(Ordering::Acquire);
            self.text.clear();
            self.ends.clear();
            let datagrams = matches!(open, Open::Udp(_));
            if open.goes_on() && self.counts.cut.load(Ordering::Relaxed) {
                self.text.push('\n');
            }
            while self.text.len() < AT_ONCE && (!datagrams || self.ends.is_empty()) {
                let Some(row) = self.row() else { break };
                self.spell(&row);
                self.give_back(row);
                self.ends.push(self.text.len());
            }
            if !self.ends.is_empty() {
                let mut sent = 0;
                let written = open.write(self.text.as_bytes(), &mut sent, name, stop);
                self.count(sent);
                match written {
                    Err(why) => return why,
                    Ok(true) if !runs => {
                        runs = true;
                        let _ = self.notices.try_send(Notice::Runs);
                    }
                    Ok(_) => {}
                }
                continue;
            }
            if last || stop.is_set() {
                open.finish();
                return String::new();
            }
            open.hear(stop);
            let _ = stop.poll(&[], LOOK);
        }
    }

    /// Counts the lines of which all went out, and the others.
    fn count(&self, sent: usize) {
        let whole = self.ends.partition_point(|end| *end <= sent);
        self.counts.written.fetch_add(whole as u64, Ordering::Relaxed);
        self.counts.lost.fetch_add((self.ends.len() - whole) as u64, Ordering::Relaxed);
        if let Some(last) = self.text.as_bytes()[..sent].last() {
            self.counts.cut.store(*last != b'\n', Ordering::Relaxed);
        }
    }

    /// The next row, with its types taken over.
    fn row(&mut self) -> Option<Row> {
        let mut row = self.rows.try_recv().ok()?;
        if let Some(types) = row.types.take() {
            self.sizes = types.iter().map(|(_, ty)| ty.size()).collect();
            self.total = self.sizes.iter().sum();
            while self.total * self.made.now.load(Ordering::Relaxed) < MADE_BEFORE && self.made.one_more() {
                let _ = self.empty.try_send(Vec::with_capacity(self.total));
            }
            let values = apart(&self.sizes, &row.bytes);
            let each = types.iter().zip(values);
            self.spelled = Spelled::of(each.map(|((name, ty), first)| (name.as_str(), ty, first)));
            self.header_due = true;
        }
        Some(row)
    }

    fn spell(&mut self, row: &Row) {
        if std::mem::take(&mut self.header_due) && self.header && self.format == Format::Numbers {
            self.spelled.header(&mut self.text);
        }
        let values = apart(&self.sizes, &row.bytes);
        self.spelled.line(self.format, row.stamp_ns, &values, &mut self.text);
    }

    fn give_back(&self, mut row: Row) {
        row.bytes.clear();
        // One that the step made as it had none, or of smaller types.
        row.bytes.reserve(self.total);
        let _ = self.empty.try_send(row.bytes);
    }
}

fn apart<'a>(sizes: &[usize], mut bytes: &'a [u8]) -> Vec<&'a [u8]> {
    let mut values = Vec::with_capacity(sizes.len());
    for size in sizes {
        let (value, rest) = bytes.split_at_checked(*size).unwrap_or((bytes, &[]));
        values.push(value);
        bytes = rest;
    }
    values
}
