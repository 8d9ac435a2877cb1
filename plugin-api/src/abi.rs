//! The C tables both sides call through.
//!
//! Invariant: a field is never moved, retyped or removed; new fields go to the end and readers ask
//! [`has_entry`] first. Threads: the LCM serialises all calls on one instance; `step`, slots and `state_copy`
//! are the only real-time ones.

use core::ffi::c_void;

/// Version of this contract. A host loads plugins of the same major and of any minor.
pub const ABI_MAJOR: u32 = 1;
/// Grows when entries are appended. Older and newer minors load each other.
pub const ABI_MINOR: u32 = 2;
/// The one symbol a plugin exports.
pub const ENTRY_SYMBOL: &str = "trocar_plugin_v1";
/// Signature of [`ENTRY_SYMBOL`]: returns a table that lives as long as the library.
pub type EntryFn = unsafe extern "C" fn() -> *const PluginTable;

/// Tells whether the field at `offset` with `size` bytes lies inside a table that says it has `struct_size`
/// bytes.
pub const fn has_entry(struct_size: u32, offset: usize, size: usize) -> bool {
    offset + size <= struct_size as usize
}

/// Result of a class-table entry: 0 is success, negative values are the `STATUS_*` failures.
pub type Status = i32;
/// The entry did what it was asked to.
pub const STATUS_OK: Status = 0;
/// The entry refused or failed; the reason is in the error buffer.
pub const STATUS_FAILED: Status = -1;
/// The entry panicked; the component goes to FAULT and its instance is not trusted again.
pub const STATUS_PANICKED: Status = -2;
/// An argument or the configuration was not acceptable; the reason is in the error buffer.
pub const STATUS_INVALID: Status = -3;
/// The plugin does not implement this id.
pub const STATUS_UNSUPPORTED: Status = -4;

/// Outcome of a call through a slot. Non-negative: done or on its way; negative: exactly one reason why not.
pub type Outcome = i32;
/// Done before the call returned.
pub const EXECUTED: Outcome = 0;
/// On its way: it runs at the peer's next step, or was taken over by the host.
pub const QUEUED: Outcome = 1;
/// No peer is connected.
pub const UNBOUND: Outcome = -1;
/// The queue of the peer, or of the host, is full; nothing was queued.
pub const QUEUE_FULL: Outcome = -2;
/// Waiting is not allowed on this thread (a `call` from `step` to another executor).
pub const WOULD_BLOCK: Outcome = -3;
/// The command does not belong to its component's ports any more, or the host takes no more requests for
/// services.
pub const DISABLED: Outcome = -4;
/// An argument, a value or a request is not acceptable.
pub const INVALID_ARGUMENT: Outcome = -5;
/// The command ran and failed; the reason is in `CallOpts::err`.
pub const FAILED: Outcome = -6;
/// No answer in time; `CallOpts::may_still_run` tells whether it may still be executed.
pub const DEADLINE: Outcome = -7;
/// The peer was lost, or the connection was cut, before there was an answer.
pub const PEER_LOST: Outcome = -8;
/// The component does not take calls in its state, or is gone.
pub const NOT_ACTIVE: Outcome = -9;
/// The frame pool of an output has no free slot; the frame is dropped and counted.
pub const EXHAUSTED: Outcome = -10;

/// Borrowed bytes; text is UTF-8 without a terminating zero. `ptr` may be null only when `len` is 0.
#[repr(C)]
#[derive(Clone, Copy)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct Bytes {
    /// Address of the first byte.
    pub ptr: *const u8,
    /// Number of bytes.
    pub len: usize,
}

/// Caller-owned buffer for one sentence of explanation; the callee writes at most `cap` bytes and sets `len`.
#[repr(C)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct ErrBuf {
    /// Address of the buffer.
    pub ptr: *mut u8,
    /// Bytes there is room for.
    pub cap: usize,
    /// Bytes written.
    pub len: usize,
}

/// A callback that takes bytes; may be called several times, the pieces are concatenated.
#[repr(C)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct Sink {
    /// The caller's own; handed to `write` unchanged.
    pub ctx: *mut c_void,
    /// Takes the next piece; on the thread of the call that was given the sink, before that returns.
    pub write: unsafe extern "C" fn(ctx: *mut c_void, bytes: Bytes),
}

/// Table that a plugin's entry returns.
#[repr(C)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct PluginTable {
    /// Bytes of this struct, as its maker knows it: see [`has_entry`].
    pub struct_size: u32,
    /// 0: no bit has a meaning yet.
    pub flags: u32,
    /// [`ABI_MAJOR`] the plugin was built with.
    pub abi_major: u32,
    /// [`ABI_MINOR`] the plugin was built with.
    pub abi_minor: u32,
    /// Name of the plugin, as in its manifest.
    pub name: Bytes,
    /// Version of the plugin, as in its manifest.
    pub version: Bytes,
    /// Called once after dlopen, before any instance: install log forwarding and panic hook. May be null.
    pub init: Option<unsafe extern "C" fn(host: *const HostTable) -> Status>,
    /// Number of classes.
    pub class_count: u32,
    /// 0.
    pub reserved: u32,
    /// `class_count` pointers, in the manifest's order.
    pub classes: *const *const ClassTable,
}

/// One component class. A null entry is not implemented. Ids are positions in the manifest, counted over all
/// interfaces of the class in order: commands and emitted events over the provided ones, functions and event
/// handlers over the required ones.
#[repr(C)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct ClassTable {
    /// Bytes of this struct, as its maker knows it: see [`has_entry`].
    pub struct_size: u32,
    /// 0: no bit has a meaning yet.
    pub flags: u32,
    /// Name of the class, as in the manifest.
    pub name: Bytes,
    /// Makes an instance in its unconfigured state; null on failure, with the reason in `err`. Opens no
    /// device.
    pub create: Option<
        unsafe extern "C" fn(host: *const HostTable, instance_name: Bytes, err: *mut ErrBuf) -> *mut c_void,
    >,
    /// Ends an instance; nothing is called on it afterwards.
    pub destroy: Option<unsafe extern "C" fn(this: *mut c_void)>,
    /// Takes the whole configuration as JSON, already checked against the class's schema by the host.
    pub configure: Option<unsafe extern "C" fn(this: *mut c_void, json: Bytes, err: *mut ErrBuf) -> Status>,
    /// Writes the class description (JSON as in the manifest) that holds for the current configuration.
    pub describe: Option<unsafe extern "C" fn(this: *mut c_void, sink: *const Sink) -> Status>,
    /// Hands over the slot tables; called again after `describe` changed them. They stay valid until the next
    /// `bind` or `destroy`.
    pub bind:
        Option<unsafe extern "C" fn(this: *mut c_void, ports: *const Ports, err: *mut ErrBuf) -> Status>,
    /// A fresh start: makes run-time state, before the first step.
    pub start: Option<unsafe extern "C" fn(this: *mut c_void, err: *mut ErrBuf) -> Status>,
    /// Ends a run, after its last step.
    pub stop: Option<unsafe extern "C" fn(this: *mut c_void, err: *mut ErrBuf) -> Status>,
    /// Goes on after a stop, with the run-time state that is there.
    pub resume: Option<unsafe extern "C" fn(this: *mut c_void, err: *mut ErrBuf) -> Status>,
    /// Brings the device to its safe condition; called on FAULT, Stop, peer loss and shutdown. For a class
    /// that says `safe_from_any_thread` it may run beside any other entry of the same instance, and beside
    /// itself: it touches only what is made for several threads, and nothing that another entry replaces.
    pub make_safe: Option<unsafe extern "C" fn(this: *mut c_void, err: *mut ErrBuf) -> Status>,
    /// One cycle. Real-time thread: no allocation, no lock, no waiting.
    pub step: Option<unsafe extern "C" fn(this: *mut c_void, tick: *const Tick, err: *mut ErrBuf) -> Status>,
    /// Executes a void, write, void-return or write-return command.
    pub command: Option<
        unsafe extern "C" fn(
            this: *mut c_void,
            id: u32,
            arg: *const c_void,
            ret: *mut c_void,
            err: *mut ErrBuf,
        ) -> Status,
    >,
    /// Executes a read or qualified read as a pure function of one published state row. Any thread, no
    /// instance.
    pub read: Option<
        unsafe extern "C" fn(
            state_row: *const c_void,
            id: u32,
            arg: *const c_void,
            ret: *mut c_void,
            err: *mut ErrBuf,
        ) -> Status,
    >,
    /// An event of a required interface.
    pub on_event: Option<
        unsafe extern "C" fn(this: *mut c_void, id: u32, payload: *const c_void, err: *mut ErrBuf) -> Status,
    >,
    /// The reply to an earlier `HostTable::service`, as JSON.
    pub on_service: Option<unsafe extern "C" fn(this: *mut c_void, token: u64, reply: Bytes) -> Status>,
    /// Copies the plain state block (the manifest's `state` type, `len` bytes) to `dst`.
    pub state_copy: Option<unsafe extern "C" fn(this: *mut c_void, dst: *mut c_void, len: usize)>,
    /// Writes what must survive a swap and is not in the plain state block.
    pub snapshot: Option<unsafe extern "C" fn(this: *mut c_void, sink: *const Sink) -> Status>,
    /// Takes a `snapshot` and, before it, the plain state block converted to this version's type (may be
    /// empty).
    pub restore: Option<
        unsafe extern "C" fn(this: *mut c_void, state: Bytes, snapshot: Bytes, err: *mut ErrBuf) -> Status,
    >,
    /// Growth without touching this table: "trocar.shadow/1", "trocar.selftest/1"; null when unknown.
    pub extension: Option<unsafe extern "C" fn(this: *mut c_void, id: Bytes) -> *const c_void>,
}

/// Facts about the cycle for a `step`. All times are ns of the host's monotonic clock.
#[repr(C)]
#[derive(Clone, Copy, Default, Debug)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct Tick {
    /// Bytes of this struct, as its maker knows it: see [`has_entry`].
    pub struct_size: u32,
    /// 0: no bit has a meaning yet.
    pub flags: u32,
    /// Cycle number since Start, from 0; skipped cycles are counted too.
    pub cycle: u64,
    /// When this step began.
    pub now_ns: u64,
    /// When it should have begun; equals `now_ns` for executors without a grid.
    pub deadline_ns: u64,
    /// Nominal period; 0 when the component is not periodic.
    pub period_ns: u64,
    /// Time since the previous step began; `period_ns` on the first.
    pub elapsed_ns: u64,
}

/// The slot tables of one instance, each an array of pointers in the manifest's order.
#[repr(C)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct Ports {
    /// Bytes of this struct, as its maker knows it: see [`has_entry`].
    pub struct_size: u32,
    /// Number of outputs.
    pub output_count: u32,
    /// Number of inputs.
    pub input_count: u32,
    /// Number of functions.
    pub function_count: u32,
    /// Number of events.
    pub event_count: u32,
    /// 0.
    pub reserved: u32,
    /// `output_count` pointers.
    pub outputs: *const *const OutSlot,
    /// `input_count` pointers.
    pub inputs: *const *const InSlot,
    /// `function_count` pointers.
    pub functions: *const *const FnSlot,
    /// `event_count` pointers.
    pub events: *const *const EventSlot,
}

/// Room for one frame, lent by the pool of an output.
#[repr(C)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct Loan {
    /// Bytes of this struct, as its maker knows it: see [`has_entry`].
    pub struct_size: u32,
    /// 0: no bit has a meaning yet.
    pub flags: u32,
    /// Room for the header, as large as the output's header type.
    pub header: *mut c_void,
    /// Room for the bytes after the header.
    pub bytes: *mut u8,
    /// Bytes available behind `bytes`.
    pub capacity: u64,
    /// The host's own; handed back unchanged.
    pub token: u64,
}

impl Loan {
    /// A loan to be asked for: of this minor's size, with nothing in it.
    pub const EMPTY: Loan = Loan {
        struct_size: size_of::<Loan>() as u32,
        flags: 0,
        header: core::ptr::null_mut(),
        bytes: core::ptr::null_mut(),
        capacity: 0,
        token: 0,
    };
}

/// An output. Never waits for a reader.
#[repr(C)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct OutSlot {
    /// Bytes of this struct, as its maker knows it: see [`has_entry`].
    pub struct_size: u32,
    /// 0: no bit has a meaning yet.
    pub flags: u32,
    /// The host's own; handed to each entry unchanged.
    pub ctx: *mut c_void,
    /// Publishes a copy of one plain sample. EXECUTED, or UNBOUND when nobody is connected.
    pub write: unsafe extern "C" fn(ctx: *mut c_void, value: *const c_void, stamp_ns: u64) -> Outcome,
    /// Lends room for one frame; EXHAUSTED when every slot is in use (counted).
    pub loan: unsafe extern "C" fn(ctx: *mut c_void, loan: *mut Loan) -> Outcome,
    /// Publishes a loan of which `len` bytes are filled; the loan is gone afterwards.
    pub commit: unsafe extern "C" fn(ctx: *mut c_void, loan: *mut Loan, len: u64, stamp_ns: u64) -> Outcome,
    /// Gives a loan back unpublished.
    pub cancel: unsafe extern "C" fn(ctx: *mut c_void, loan: *mut Loan),
    /// Publishes a frame held by an input as this output, without a copy.
    pub forward: unsafe extern "C" fn(ctx: *mut c_void, sample: *const SampleView, stamp_ns: u64) -> Outcome,
    /// (Re)makes the pool: `slots` frames of up to `max_bytes`. From `configure` and `start` only.
    pub reserve: unsafe extern "C" fn(ctx: *mut c_void, max_bytes: u64, slots: u32) -> Outcome,
    /// The type now behind an untyped port, as manifest JSON; STATUS_UNSUPPORTED while unconnected.
    pub type_of: unsafe extern "C" fn(ctx: *mut c_void, sink: *const Sink) -> Status,
    /// Since 1.1. As `write`, for an untyped output: INVALID_ARGUMENT unless `value` has the size of the type
    /// now behind it, so a change of connections between `type_of` and the write is no danger.
    pub write_bytes: unsafe extern "C" fn(ctx: *mut c_void, value: Bytes, stamp_ns: u64) -> Outcome,
}

/// Set in [`SampleView::flags`] when the sample had not been seen by this input before.
pub const SAMPLE_FRESH: u32 = 1;
/// Set when the sample is older than the connection's `max_age`, by its stamp or by the time it came.
pub const SAMPLE_STALE: u32 = 2;

/// One sample or frame, valid until the next `latest`, `next` or `release` on the same input.
#[repr(C)]
#[derive(Clone, Copy)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct SampleView {
    /// Bytes of this struct, as its maker knows it: see [`has_entry`].
    pub struct_size: u32,
    /// [`SAMPLE_FRESH`], [`SAMPLE_STALE`].
    pub flags: u32,
    /// The plain value, or the header of a frame.
    pub header: *const c_void,
    /// The bytes of a frame after its header; null for a plain value.
    pub bytes: *const u8,
    /// Number of these bytes.
    pub len: u64,
    /// Stamp the writer gave it, ns of the host's monotonic clock; 0 = invalid.
    pub stamp_ns: u64,
    /// Counts the writes of the output, from 1; a gap is exactly what was dropped on the way.
    pub seq: u64,
    /// The host's own; handed back unchanged.
    pub token: u64,
}

impl SampleView {
    /// A view to be lent: of this minor's size, with nothing in it.
    pub const EMPTY: SampleView = SampleView {
        struct_size: size_of::<SampleView>() as u32,
        flags: 0,
        header: core::ptr::null(),
        bytes: core::ptr::null(),
        len: 0,
        stamp_ns: 0,
        seq: 0,
        token: 0,
    };
}

/// Answer of `latest` and `next`: a sample is in the view.
pub const IN_SAMPLE: i32 = 1;
/// Nothing (new) there.
pub const IN_EMPTY: i32 = 0;
/// No output is connected.
pub const IN_UNBOUND: i32 = -1;

/// An input. `latest` gives the newest sample again and again (see [`SAMPLE_FRESH`]); `next` gives each once,
/// in order.
#[repr(C)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct InSlot {
    /// Bytes of this struct, as its maker knows it: see [`has_entry`].
    pub struct_size: u32,
    /// 0: no bit has a meaning yet.
    pub flags: u32,
    /// The host's own; handed to each entry unchanged.
    pub ctx: *mut c_void,
    /// Shows the newest sample, seen before or not; older unseen ones are skipped. [`IN_SAMPLE`] and the
    /// others.
    pub latest: unsafe extern "C" fn(ctx: *mut c_void, view: *mut SampleView) -> i32,
    /// Shows the next unseen sample, in order. [`IN_SAMPLE`] and the others.
    pub next: unsafe extern "C" fn(ctx: *mut c_void, view: *mut SampleView) -> i32,
    /// Hands the held sample back before the next one is asked for.
    pub release: unsafe extern "C" fn(ctx: *mut c_void),
    /// Writable bytes of the held frame when this input is its only owner, else null.
    pub writable: unsafe extern "C" fn(ctx: *mut c_void, view: *mut SampleView) -> *mut u8,
    /// The type now behind an untyped port, as manifest JSON; STATUS_UNSUPPORTED while unconnected.
    pub type_of: unsafe extern "C" fn(ctx: *mut c_void, sink: *const Sink) -> Status,
    /// Since 1.1. Bytes of the plain value, or of the header of the frame, in the sample shown last; 0
    /// without one.
    pub header_len: unsafe extern "C" fn(ctx: *mut c_void) -> u64,
    /// Since 1.2. Holds the frame shown last beyond the next one: IN_SAMPLE, and `held` is filled; IN_EMPTY
    /// where it was no frame, or where too few frames would stay free for its source; IN_UNBOUND without a
    /// connection. The caller sets `struct_size`. For the component's thread, as the others.
    pub hold: unsafe extern "C" fn(ctx: *mut c_void, held: *mut Held) -> i32,
}

/// A held frame, independent of the input, as long as the plugin's own code runs. Since 1.2.
#[repr(C)]
#[derive(Clone, Copy)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct Held {
    /// Bytes of this struct, as its maker knows it: see [`has_entry`].
    pub struct_size: u32,
    /// 0: no bit has a meaning yet.
    pub flags: u32,
    /// They stay as they are until `release`; of another process, as long as that is linked to this one.
    pub bytes: *const u8,
    /// Number of bytes.
    pub len: u64,
    /// The host's own.
    pub token: u64,
    /// Gives the frame back: once, from any thread.
    pub release: unsafe extern "C" fn(token: u64),
}

/// Returns at once: EXECUTED when it ran inline, QUEUED, or the reason why not.
pub const MODE_SEND: u32 = 0;
/// Waits for the result, at most until the deadline.
pub const MODE_CALL: u32 = 1;

/// Options and out-fields of one call. A null pointer means MODE_SEND.
#[repr(C)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct CallOpts {
    /// Bytes of this struct, as its maker knows it: see [`has_entry`].
    pub struct_size: u32,
    /// [`MODE_SEND`] or [`MODE_CALL`].
    pub mode: u32,
    /// Relative, ns; 0 = the connection's default (1 s unless set), more than an hour counts as an hour. A
    /// command that is only sent and has not begun by then never runs; with 0 the connection and the server's
    /// class say how long its goal is right.
    pub deadline_ns: u64,
    /// Buffer for the reason; may be null.
    pub err: *mut ErrBuf,
    /// Out: stamp of the state row a read was answered from.
    pub stamp_ns: u64,
    /// Out: 1 when the outcome is DEADLINE and the command may still run.
    pub may_still_run: u32,
    /// 0.
    pub reserved: u32,
}

/// A function of a required interface.
#[repr(C)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct FnSlot {
    /// Bytes of this struct, as its maker knows it: see [`has_entry`].
    pub struct_size: u32,
    /// 0: no bit has a meaning yet.
    pub flags: u32,
    /// The host's own; handed to each entry unchanged.
    pub ctx: *mut c_void,
    /// Calls the command that is bound; `arg` and `ret` are null where the function has none.
    pub call: unsafe extern "C" fn(
        ctx: *mut c_void,
        arg: *const c_void,
        ret: *mut c_void,
        opts: *mut CallOpts,
    ) -> Outcome,
    /// The command's description now behind an untyped function, as manifest JSON; STATUS_UNSUPPORTED while
    /// unconnected.
    pub type_of: unsafe extern "C" fn(ctx: *mut c_void, sink: *const Sink) -> Status,
    /// Since 1.1. As `call`, for an untyped function: INVALID_ARGUMENT unless `arg` and `ret_len` have the
    /// sizes of the command now behind it. `arg` is aligned to 8; a command that is only sent may leave `ret`
    /// out (null and 0).
    pub call_bytes: unsafe extern "C" fn(
        ctx: *mut c_void,
        arg: Bytes,
        ret: *mut c_void,
        ret_len: u64,
        opts: *mut CallOpts,
    ) -> Outcome,
}

/// An event generator of a provided interface.
#[repr(C)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct EventSlot {
    /// Bytes of this struct, as its maker knows it: see [`has_entry`].
    pub struct_size: u32,
    /// 0: no bit has a meaning yet.
    pub flags: u32,
    /// The host's own; handed to each entry unchanged.
    pub ctx: *mut c_void,
    /// Broadcasts; EXECUTED, or QUEUE_FULL when at least one observer missed it (counted there).
    pub emit: unsafe extern "C" fn(ctx: *mut c_void, payload: *const c_void) -> Outcome,
}

/// Level of [`HostTable::log`], as in the `log` crate: something was not done.
pub const LOG_ERROR: u32 = 1;
/// Something may be wrong.
pub const LOG_WARN: u32 = 2;
/// News.
pub const LOG_INFO: u32 = 3;
/// Details for the search of a mistake.
pub const LOG_DEBUG: u32 = 4;
/// The finest details.
pub const LOG_TRACE: u32 = 5;

/// Set in [`HostTable::flags`] at `init` when the plugin is linked into the host's own program: they share
/// their statics, so a logger that forwards to the host would forward to itself.
pub const HOST_LINKED: u32 = 1;

/// Services of the host for one instance (`create`) or for a whole plugin (`init`).
#[repr(C)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct HostTable {
    /// Bytes of this struct, as its maker knows it: see [`has_entry`].
    pub struct_size: u32,
    /// [`HOST_LINKED`], or 0.
    pub flags: u32,
    /// [`ABI_MAJOR`] of the host.
    pub abi_major: u32,
    /// [`ABI_MINOR`] of the host.
    pub abi_minor: u32,
    /// The host's own; handed to each entry unchanged.
    pub ctx: *mut c_void,
    /// Monotonic clock, ns. Any thread.
    pub now_ns: unsafe extern "C" fn(ctx: *mut c_void) -> u64,
    /// Any thread; from `step` the line is put in a bounded ring and written elsewhere.
    pub log: unsafe extern "C" fn(ctx: *mut c_void, level: u32, target: Bytes, message: Bytes),
    /// A dynamic component service, as the JSON of the gRPC request with its verb: `{"verb":"Create",…}`.
    /// The reply arrives in `ClassTable::on_service` with the same token. WOULD_BLOCK from `step`.
    pub service: unsafe extern "C" fn(ctx: *mut c_void, token: u64, request: Bytes) -> Outcome,
    /// Brackets a call that comes in on a thread of the plugin's own (execution model `on_callback`).
    pub callback_enter: unsafe extern "C" fn(ctx: *mut c_void) -> Outcome,
    /// Ends what `callback_enter` began, on the same thread.
    pub callback_leave: unsafe extern "C" fn(ctx: *mut c_void),
    /// Growth without touching this table: "trocar.parallel/1"; null when unknown.
    pub extension: unsafe extern "C" fn(ctx: *mut c_void, id: Bytes) -> *const c_void,
    /// Since 1.1. Asks for `describe` and `bind` between two steps, because the ports have to change. Any
    /// thread; QUEUED.
    pub ports_changed: unsafe extern "C" fn(ctx: *mut c_void) -> Outcome,
}

/// Id of the host extension [`Parallel`].
pub const PARALLEL: &str = "trocar.parallel/1";

/// The threads of the stream a component runs in, for filters that can work on slices of a frame at once.
#[repr(C)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct Parallel {
    /// Bytes of this struct, as its maker knows it: see [`has_entry`].
    pub struct_size: u32,
    /// 0: no bit has a meaning yet.
    pub flags: u32,
    /// The host's own; handed to each entry unchanged.
    pub ctx: *mut c_void,
    /// Threads that work together now, the caller's included; 1 without a pool.
    pub threads: unsafe extern "C" fn(ctx: *mut c_void) -> u32,
    /// Runs `body` once for each slice number below `slices`, on any of the threads, and returns when all are
    /// done: the first negative status, or STATUS_OK. Only from `step`, commands and handlers of the
    /// component; not from a body.
    pub run: unsafe extern "C" fn(ctx: *mut c_void, slices: u32, body: *const SliceBody) -> Status,
}

/// The work on one slice; called from several threads at once, so `data` is shared. Nothing may unwind out of
/// `run`.
#[repr(C)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct SliceBody {
    /// The caller's own; handed to `run` unchanged.
    pub data: *mut c_void,
    /// Does the work on this slice; a negative status is a failure.
    pub run: unsafe extern "C" fn(data: *mut c_void, slice: u32) -> Status,
}

/// Id of the host extension [`Keep`].
pub const KEEP: &str = "trocar.keep/1";

/// For code that cannot be sure that nobody still holds what an instance was given, its host table or a slot.
#[repr(C)]
#[cfg_attr(feature = "layout", derive(abi_stable::StableAbi))]
pub struct Keep {
    /// Bytes of this struct, as its maker knows it: see [`has_entry`].
    pub struct_size: u32,
    /// 0: no bit has a meaning yet.
    pub flags: u32,
    /// Keeps all that the instance of this table was given as it is until the process ends, destroyed or not;
    /// slots answer as those of ports without a connection. `ctx` is that of the `HostTable`. Any thread, at
    /// the latest from `bind` or `destroy`.
    pub keep: unsafe extern "C" fn(ctx: *mut c_void),
}

/// A plugin linked into the executable: its manifest, which a file carries as a note, and its entry.
#[derive(Clone, Copy, Debug)]
pub struct StaticPlugin {
    /// JSON, as in `.note.trocar`.
    pub manifest: &'static str,
    /// The function a file exports as [`ENTRY_SYMBOL`].
    pub entry: EntryFn,
}
