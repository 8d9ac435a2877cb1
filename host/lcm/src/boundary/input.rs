//! Inputs: the slots through which samples and frames reach a component.
//!
//! Invariant: a sample an input shows stays valid until the next `latest`, `next` or `release` on it, even
//! when the connection is cut meanwhile (the input keeps alive the link whose sample it shows). A link holds
//! no sample and no frame from the moment the component has left it, or from the cut if the component never
//! took it up, whichever cycle still looks at it.

use std::cell::UnsafeCell;
use std::ffi::c_void;
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

use trocar_model::CopyRun;
use trocar_plugin_api::abi::{
    Held, IN_EMPTY, IN_SAMPLE, IN_UNBOUND, INVALID_ARGUMENT, Outcome, SAMPLE_FRESH, SAMPLE_STALE, SampleView,
    Sink, Status,
};
use trocar_rt::cell::BindingCell;
use trocar_rt::left::{Leave, Left, LeftList};
use trocar_rt::os;
use trocar_rt::pool::Frame;
use trocar_rt::segment::Word;
use trocar_rt::stream::{Sample, StreamReader};
use trocar_rt::timing::Histogram;

use super::super::context;
use super::host_table::HostContext;
use super::{room, texts};

/// Number of the next link of this process; never used twice, as an address would be.
static NEXT: AtomicU64 = AtomicU64::new(1);

/// User of a link's reader, in this order: the manager that made it, the component's thread, nobody.
mod whose {
    pub(super) const NOT_TAKEN: u8 = 0;
    pub(super) const TAKEN: u8 = 1;
    pub(super) const CLOSED: u8 = 2;
}

/// The consumer's end of one connection; stands behind its input once.
pub(crate) struct InLink {
    /// Tells a component by which connection a sample came.
    serial: u64,
    /// See [`whose`].
    whose: AtomicU8,
    reader: UnsafeCell<StreamReader>,
    /// Samples that may wait.
    depth: usize,
    /// Older samples are stale, ns; 0 = never.
    max_age_ns: u64,
    newest_ns: Newest,
    /// Age of samples when first shown, ns.
    pub(crate) latency: Histogram,
    /// The output's type as manifest JSON.
    described: Arc<str>,
    adapt: Option<Adapt>,
    left: Left<InLink>,
}

/// Stamp of the newest sample written, ns; kept where there is a `max_age`.
pub(crate) enum Newest {
    Here(Arc<AtomicU64>),
    /// Written by another process; the time of connecting counts until the first write.
    Remote(Word, u64),
}

/// Most by which the clock of a look may lag behind that of a write, ns.
const AHEAD_NS: u64 = 1_000_000_000;

impl Newest {
    /// Starts with the time of connecting.
    pub(crate) fn here() -> (Newest, Arc<AtomicU64>) {
        let stamp = Arc::new(AtomicU64::new(os::now_ns()));
        (Newest::Here(stamp.clone()), stamp)
    }

    /// The stamp, seen at `now_ns`.
    fn get(&self, now_ns: u64) -> u64 {
        match self {
            Newest::Here(stamp) => stamp.load(Ordering::Relaxed),
            Newest::Remote(stamp, connected_ns) => {
                // A stamp still ahead of the clock must not keep an input fresh for ever.
                let said = Some(stamp.get()).filter(|said| *said <= now_ns.saturating_add(AHEAD_NS));
                said.unwrap_or(0).max(*connected_ns)
            }
        }
    }
}

// SAFETY: the place belongs to this link; a link stands behind one input, which leaves it to its own list.
unsafe impl Leave for InLink {
    fn left(&self) -> &Left<InLink> {
        &self.left
    }
}

/// What an input shows, to be passed on unchanged.
pub(crate) enum Shown<'a> {
    Frame(Frame),
    Plain(&'a [u8]),
    /// Nothing that could be passed on.
    Nothing,
}

/// Samples of another layout, copied by name into room of the input's own type.
struct Adapt {
    plan: Vec<CopyRun>,
    /// Size of the input's type.
    bytes: usize,
    room: UnsafeCell<Box<[u64]>>,
}

// SAFETY: reader and room are used only by the user that `whose` names, one at a time; the rest is lock-free
// or immutable.
unsafe impl Sync for InLink {}
// SAFETY: as above.
unsafe impl Send for InLink {}

impl InLink {
    /// `adapt`: the copy plan and the bytes of the input's type, where the output's layout is another.
    pub(crate) fn new(
        reader: StreamReader,
        depth: usize,
        max_age_ns: u64,
        newest_ns: Newest,
        described: Arc<str>,
        adapt: Option<(Vec<CopyRun>, usize)>,
    ) -> Self {
        let adapt = adapt.map(|(plan, bytes)| Adapt {
            plan,
            bytes,
            room: UnsafeCell::new(vec![0; bytes.div_ceil(8)].into_boxed_slice()),
        });
        InLink {
            serial: NEXT.fetch_add(1, Ordering::Relaxed),
            whose: AtomicU8::new(whose::NOT_TAKEN),
            reader: UnsafeCell::new(reader),
            depth,
            max_age_ns,
            newest_ns,
            latency: Histogram::new(),
            described,
            adapt,
            left: Left::default(),
        }
    }

    /// Takes the reader for the calling thread, the component's; false when the link was cut before that.
    fn take(&self) -> bool {
        self.pass_to(whose::TAKEN) != Err(whose::CLOSED)
    }

    /// Passes the reader to `whose` unless it was taken or closed before; then returns its present user. Any
    /// thread.
    fn pass_to(&self, whose: u8) -> Result<u8, u8> {
        // Orders the new user's accesses after all earlier ones, in both directions.
        self.whose.compare_exchange(whose::NOT_TAKEN, whose, Ordering::AcqRel, Ordering::Acquire)
    }

    /// Closes a link that stands behind its input no more: the samples waiting in it go back now, unless the
    /// component has taken it up.
    fn close_if_not_taken(&self) {
        if self.pass_to(whose::CLOSED).is_ok() {
            // SAFETY: nobody has taken the reader, and nobody can any more.
            unsafe { &mut *self.reader.get() }.close();
        }
    }

    /// Gives back the samples that wait in the link, and the one shown from it last.
    ///
    /// # Safety
    /// The component's thread has taken the link and has left it, or has used it for the last time; and no
    /// other thread calls this meanwhile.
    unsafe fn close(&self) {
        self.whose.store(whose::CLOSED, Ordering::Release);
        // SAFETY: the caller's promise.
        unsafe { &mut *self.reader.get() }.close();
    }

    /// Tells whether nothing younger than `max_age` was written. Any thread.
    pub(crate) fn is_stale(&self, now_ns: u64) -> bool {
        let age_ns = now_ns.saturating_sub(self.newest_ns.get(now_ns));
        self.max_age_ns > 0 && age_ns > self.max_age_ns
    }

    /// Gives `f` the sample held here, a frame without a copy. With `give` the frame leaves this input, so
    /// that its next reader may be its only owner.
    ///
    /// # Safety
    /// Consuming component's thread only.
    unsafe fn pass_on(&self, give: bool, f: impl FnOnce(Shown<'_>) -> Outcome) -> Outcome {
        // SAFETY: the caller's promise.
        let reader = unsafe { &mut *self.reader.get() };
        let frame = if give { reader.take_frame() } else { reader.frame().cloned() };
        f(match (frame, reader.current()) {
            (Some(frame), _) => Shown::Frame(frame),
            // An adapted sample has the layout of this input, not of its source.
            (None, Some(_)) if self.adapt.is_some() => Shown::Nothing,
            (None, Some(sample)) => Shown::Plain(sample.data),
            (None, None) => Shown::Nothing,
        })
    }
}

impl Adapt {
    /// The sample as the input's own type. Consuming component's thread only.
    fn copy(&self, data: &[u8]) -> *const u8 {
        // SAFETY: consuming component's thread only, and the last look at the room has ended with the sample
        // before.
        let room = unsafe { &mut *self.room.get() };
        let to: *mut u8 = room.as_mut_ptr().cast();
        let bytes = size_of_val(&**room);
        for run in &self.plan {
            if run.from + run.len <= data.len() && run.to + run.len <= bytes {
                // SAFETY: both runs lie inside their blocks, which are different allocations.
                unsafe { to.add(run.to).copy_from_nonoverlapping(data.as_ptr().add(run.from), run.len) };
            }
        }
        to
    }
}

/// Host cell behind an input slot.
pub(crate) struct InCell {
    link: BindingCell<Option<Arc<InLink>>>,
    /// The link the last view came from.
    held: UnsafeCell<Option<Arc<InLink>>>,
    /// Earlier links, for a manager to drop: the component's thread frees no memory.
    left: LeftList<InLink>,
    /// Set when the component that owned the input is gone.
    gone: OnceLock<Arc<HostContext>>,
}

// SAFETY: `held` is used only by the component's thread, one at a time.
unsafe impl Sync for InCell {}
// SAFETY: as above.
unsafe impl Send for InCell {}

impl InCell {
    pub(crate) fn new() -> Self {
        InCell {
            link: BindingCell::new(Box::new(None)),
            held: UnsafeCell::new(None),
            left: LeftList::default(),
            gone: OnceLock::new(),
        }
    }

    /// Marks the input's component as gone: its samples go back.
    pub(super) fn retire(&self, gone: &Arc<HostContext>) {
        let _ = self.gone.set(gone.clone());
        self.let_go();
    }

    /// Gives back the sample the input shows and those that wait in its link. Called after the component's
    /// thread has used the input for the last time.
    pub(super) fn let_go(&self) {
        self.connect(None);
        // SAFETY: the component's thread has used the input for the last time, and no other thread may look
        // at samples of an input.
        if let Some(held) = unsafe { &mut *self.held.get() }.take() {
            // SAFETY: as above; a held link is in no list.
            unsafe { held.close() };
        }
    }

    #[cold]
    fn unbound(&self) -> i32 {
        if let Some(gone) = self.gone.get() {
            gone.note_late();
        }
        IN_UNBOUND
    }

    /// Puts a link behind the input, or none; managers only.
    pub(crate) fn connect(&self, link: Option<Arc<InLink>>) {
        self.link
            .swap_seeing(Box::new(link), |before| before.iter().for_each(|link| link.close_if_not_taken()));
    }

    pub(super) fn reclaim(&self) -> usize {
        // SAFETY: the component's thread took the link and has left it, another link stands behind the input,
        // and the list shows it to one manager.
        self.left.drop_each(|link| unsafe { link.close() });
        self.link.reclaim()
    }

    /// Tells whether nothing younger than its connection's `max_age` was written. Any thread.
    pub(crate) fn is_stale(&self, now_ns: u64) -> bool {
        self.link.enter().as_ref().is_some_and(|link| link.is_stale(now_ns))
    }

    /// Gives `f` samples not seen yet, with their stamps, unchanged: as many as can wait at once, so that a
    /// flood from another thread cannot keep the cycle from its end. True when there may be more. Component's
    /// thread only; real-time.
    pub(crate) fn bypass(&self, f: impl Fn(Shown<'_>, u64) -> Outcome) -> bool {
        let mut view = SampleView::EMPTY;
        let mut passed = 0;
        loop {
            if self.show(&raw mut view, StreamReader::next) != IN_SAMPLE {
                return false;
            }
            // SAFETY: component's thread only.
            let Some(link) = (unsafe { &*self.held.get() }) else { return false };
            // SAFETY: as above.
            unsafe { link.pass_on(true, |shown| f(shown, view.stamp_ns)) };
            passed += 1;
            if passed >= link.depth {
                return true;
            }
        }
    }

    /// Gives `f` the sample this input shows; `None` when `token` belongs to another input.
    ///
    /// # Safety
    /// Component's thread only.
    pub(super) unsafe fn pass_on(&self, token: u64, f: impl FnOnce(Shown<'_>) -> Outcome) -> Option<Outcome> {
        // SAFETY: the caller's promise.
        let link = unsafe { &*self.held.get() }.as_ref()?;
        // SAFETY: as above.
        (link.serial == token).then(|| unsafe { link.pass_on(false, f) })
    }

    /// Takes the present link and shows the sample that `pick` finds there. Component's thread only. Compiled
    /// once for each `pick`: a sample handed over in memory costs an eighth of a hop.
    #[inline(always)]
    fn show(
        &self,
        view: *mut SampleView,
        pick: impl for<'r> FnOnce(&'r mut StreamReader) -> Option<Sample<'r>>,
    ) -> i32 {
        // SAFETY: component's thread only.
        let held = unsafe { &mut *self.held.get() };
        let left = self.link.look(|now| match now {
            Some(link) if held.as_ref().is_some_and(|h| Arc::ptr_eq(h, link)) => None,
            now => std::mem::replace(held, now.as_ref().filter(|link| link.take()).cloned()),
        });
        if let Some(left) = left {
            self.left.leave(left);
        }
        let Some(link) = held.as_ref() else { return self.unbound() };
        // SAFETY: component's thread only.
        let reader = unsafe { &mut *link.reader.get() };
        let Some(sample) = pick(reader) else { return IN_EMPTY };
        let mut flags = 0;
        // Takes the earlier of the sample's own time and its arrival: a stamp of another clock may be of any
        // time.
        let told_ns = sample.meta.stamp_ns.min(sample.meta.came_ns);
        if sample.fresh {
            flags |= SAMPLE_FRESH;
            link.latency.record_alone(context::about_now_ns().saturating_sub(told_ns));
        }
        if link.max_age_ns > 0 {
            let now_ns = os::now_ns();
            let old = now_ns.saturating_sub(told_ns) > link.max_age_ns;
            // A sample that waited in a queue is old although newer ones came; the newest sample is old where
            // no other came.
            if old || link.is_stale(now_ns) {
                flags |= SAMPLE_STALE;
            }
        }
        let header = match &link.adapt {
            Some(adapt) => adapt.copy(sample.data),
            None => sample.data.as_ptr(),
        };
        let shown = SampleView {
            struct_size: size_of::<SampleView>() as u32,
            flags,
            header: header.cast(),
            bytes: sample.bytes.as_ptr(),
            len: sample.bytes.len() as u64,
            stamp_ns: sample.meta.stamp_ns,
            seq: sample.meta.seq,
            token: link.serial,
        };
        // SAFETY: the caller lends room for a SampleView, see `latest` and `next`.
        unsafe { room::fill(view, shown) };
        IN_SAMPLE
    }
}

fn in_cell<'a>(ctx: *mut c_void) -> &'a InCell {
    // SAFETY: the cell whose slot this is; it lives as long as the instance that owns the slots.
    unsafe { &*ctx.cast::<InCell>() }
}

/// Token of the input a view comes from; `None` without a view.
pub(super) fn token_of(view: *const SampleView) -> Option<u64> {
    // SAFETY: null, or lent for the call; the first SampleViews had a token.
    unsafe { room::is_lent(view).then(|| (&raw const (*view).token).read()) }
}

pub(super) unsafe extern "C" fn latest(ctx: *mut c_void, view: *mut SampleView) -> i32 {
    // SAFETY: null, or lent for the call.
    let lent = unsafe { room::is_lent(view) };
    if lent { in_cell(ctx).show(view, StreamReader::latest) } else { INVALID_ARGUMENT }
}

pub(super) unsafe extern "C" fn next(ctx: *mut c_void, view: *mut SampleView) -> i32 {
    // SAFETY: null, or lent for the call.
    let lent = unsafe { room::is_lent(view) };
    if lent { in_cell(ctx).show(view, StreamReader::next) } else { INVALID_ARGUMENT }
}

pub(super) unsafe extern "C" fn release(ctx: *mut c_void) {
    // SAFETY: component's thread only.
    if let Some(link) = unsafe { &*in_cell(ctx).held.get() } {
        // SAFETY: component's thread only.
        unsafe { (*link.reader.get()).release() };
    }
}

pub(super) unsafe extern "C" fn header_len(ctx: *mut c_void) -> u64 {
    // SAFETY: component's thread only.
    let Some(link) = (unsafe { &*in_cell(ctx).held.get() }) else { return 0 };
    if let Some(adapt) = &link.adapt {
        return adapt.bytes as u64;
    }
    // SAFETY: component's thread only.
    unsafe { (*link.reader.get()).current() }.map_or(0, |sample| sample.data.len() as u64)
}

/// Gives a held frame back.
unsafe extern "C" fn release_held(token: u64) {
    // SAFETY: a count that `hold` handed out, which kept its pool alive; it comes back once.
    drop(unsafe { Frame::from_raw(token) });
}

pub(super) unsafe extern "C" fn hold(ctx: *mut c_void, held: *mut Held) -> i32 {
    // SAFETY: null, or lent for the call.
    if !unsafe { room::is_lent(held) } {
        return INVALID_ARGUMENT;
    }
    // SAFETY: component's thread only.
    let Some(link) = (unsafe { &*in_cell(ctx).held.get() }) else { return IN_UNBOUND };
    // SAFETY: component's thread only.
    let frame = unsafe { (*link.reader.get()).frame() };
    let Some(frame) = frame.filter(|frame| frame.can_be_held()).cloned() else { return IN_EMPTY };
    let bytes = frame.bytes();
    let kept = Held {
        struct_size: size_of::<Held>() as u32,
        flags: 0,
        bytes: bytes.as_ptr(),
        len: bytes.len() as u64,
        token: frame.into_raw(),
        release: release_held,
    };
    // SAFETY: lent, as seen above.
    unsafe { room::fill(held, kept) };
    IN_SAMPLE
}

pub(super) unsafe extern "C" fn writable(ctx: *mut c_void, view: *mut SampleView) -> *mut u8 {
    // SAFETY: component's thread only.
    let Some(link) = (unsafe { &*in_cell(ctx).held.get() }) else { return std::ptr::null_mut() };
    // The view of another input says nothing about the frame held here.
    if token_of(view) != Some(link.serial) {
        return std::ptr::null_mut();
    }
    // SAFETY: component's thread only.
    match unsafe { (*link.reader.get()).frame() } {
        // The only owner may write: another reference can be taken only through this input.
        Some(frame) if frame.is_unique() => frame.bytes().as_ptr().cast_mut(),
        _ => std::ptr::null_mut(),
    }
}

pub(super) unsafe extern "C" fn type_of(ctx: *mut c_void, sink: *const Sink) -> Status {
    texts::tell(sink, in_cell(ctx).link.enter().as_ref().map_or("", |link| &link.described))
}
