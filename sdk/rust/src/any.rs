//! Ports without a type of their own: they take the type of what they are connected to (recorder, player,
//! bridges).
//!
//! Invariant: the host compares sizes with the type connected at that moment, so a connection that changes
//! between two calls gives an answer, never a wrong read. No author needs `unsafe` here.

use crate::aligned;
use crate::dynamic::{AnyCommand, AnyType, Place, scan};
use crate::flow::{Flow, PortKind};
use crate::function::{FunctionPort, waiting};
use crate::lease::{Lease, Tie};
use crate::outcome::{CallError, Outcome};
use crate::ports::{In, Out};
use crate::stubs;
use crate::values::Stamp;
use core::ffi::c_void;
use core::mem::offset_of;
use core::time::Duration;
use serde_json::Value as Json;
use trocar_plugin_api::abi::{
    Bytes, CallOpts, FnSlot, Held, IN_SAMPLE, InSlot, OutSlot, STATUS_OK, SampleView, Sink, Status, has_entry,
};
use trocar_plugin_api::desc::TypeDesc;

/// Bytes of a table entry.
const ENTRY: usize = size_of::<usize>();

/// Marks an untyped port.
pub struct Any(());

/// An input that takes any type.
pub type AnyIn = In<Any>;
/// An output that takes any type.
pub type AnyOut = Out<Any>;

/// A sample of a type that is known only while running.
pub struct AnyView<'a> {
    view: SampleView,
    /// Bytes at the view's header; 0 when the host does not say (older than ABI 1.1).
    len: usize,
    slot: &'a InSlot,
}

/// A frame that is held, see [`AnyView::hold`]; when dropped, it goes back to its source. It outlives its
/// connection, its source and the component's stop; threads that hold one must have ended when the component
/// is destroyed, as all of its threads.
pub struct HeldFrame(Held);

// SAFETY: its bytes stay as they are, and any thread may give it back.
unsafe impl Send for HeldFrame {}
// SAFETY: as above; a shared one is only read.
unsafe impl Sync for HeldFrame {}

impl HeldFrame {
    /// The bytes of the frame, in place.
    pub fn bytes(&self) -> &[u8] {
        if self.0.bytes.is_null() {
            return &[];
        }
        // SAFETY: the host holds `len` readable bytes until the release.
        unsafe { core::slice::from_raw_parts(self.0.bytes, self.0.len as usize) }
    }
}

impl core::fmt::Debug for HeldFrame {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "frame of {} bytes", self.0.len)
    }
}

impl Drop for HeldFrame {
    fn drop(&mut self) {
        // SAFETY: what the host gave with this token, once.
        unsafe { (self.0.release)(self.0.token) };
    }
}

impl AnyView<'_> {
    /// The bytes of the plain value, or of the header of a frame: [`AnyType::to_json`] and
    /// [`crate::Place::number`] read them. Empty on a host older than ABI 1.1.
    pub fn value(&self) -> &[u8] {
        if self.len == 0 || self.view.header.is_null() {
            return &[];
        }
        // SAFETY: the slot says so many readable bytes, valid while the view borrows the input.
        unsafe { core::slice::from_raw_parts(self.view.header.cast(), self.len) }
    }

    /// The bytes of a frame, empty for plain samples.
    pub fn bytes(&self) -> &[u8] {
        if self.view.bytes.is_null() {
            return &[];
        }
        // SAFETY: the slot gives `len` readable bytes while the view borrows the input.
        unsafe { core::slice::from_raw_parts(self.view.bytes, self.view.len as usize) }
    }

    /// Holds the frame beyond this view, for any thread: nothing is copied, and until it is dropped its
    /// source has one frame less to fill. None for plain samples, where few of the source's frames would stay
    /// free (of another process one is held at a time), and on a host older than ABI 1.2: then copy what you
    /// need. For `step`.
    pub fn hold(&self) -> Option<HeldFrame> {
        unsafe extern "C" fn nothing(_: u64) {}
        if !has_entry(self.slot.struct_size, offset_of!(InSlot, hold), ENTRY) {
            return None;
        }
        let mut held = Held {
            struct_size: size_of::<Held>() as u32,
            flags: 0,
            bytes: core::ptr::null(),
            len: 0,
            token: 0,
            release: nothing,
        };
        // SAFETY: the entry lies inside the slot, and the room is a whole `Held`.
        let answer = unsafe { (self.slot.hold)(self.slot.ctx, &raw mut held) };
        (answer == IN_SAMPLE).then_some(HeldFrame(held))
    }

    /// When the sample was measured or written.
    pub fn stamp(&self) -> Stamp {
        Stamp::from_ns(self.view.stamp_ns)
    }

    /// Counts the writes of the output, from 1; a gap is exactly what was dropped on the way.
    pub fn seq(&self) -> u64 {
        self.view.seq
    }

    /// Stands for the connection the sample came by: when it differs from the last sample's, the type may be
    /// another.
    pub fn source(&self) -> u64 {
        self.view.token
    }

    /// Finds the place of the number at `path` in samples of this connection, as [`AnyType::place`] does.
    /// Allocates nothing: for `step`, once per connection, because it reads the description of the type.
    pub fn place(&self, path: &str) -> Option<Place> {
        struct Asked<'a> {
            path: &'a str,
            found: Option<Place>,
            pieces: usize,
        }
        unsafe extern "C" fn find(ctx: *mut c_void, bytes: Bytes) {
            if bytes.ptr.is_null() {
                return;
            }
            // SAFETY: `ctx` is the question below; the callee passes readable bytes for the call.
            let (asked, bytes) =
                unsafe { (&mut *ctx.cast::<Asked<'_>>(), core::slice::from_raw_parts(bytes.ptr, bytes.len)) };
            asked.pieces += 1;
            asked.found = core::str::from_utf8(bytes).ok().and_then(|text| scan::place(text, asked.path));
        }
        let mut asked = Asked { path, found: None, pieces: 0 };
        let sink = Sink { ctx: (&raw mut asked).cast(), write: find };
        let (type_of, ctx) = (self.slot.type_of, self.slot.ctx);
        // SAFETY: the slot and its context are valid, and the sink lives through the call.
        let status = unsafe { type_of(ctx, &sink) };
        match asked.pieces {
            _ if status != STATUS_OK => None,
            0 | 1 => asked.found,
            // No host of ours gives it in pieces; from a host that does, a copy is made.
            // SAFETY: both belong to one valid slot.
            _ => AnyType::of_port(&unsafe { ask_type(type_of, ctx) }?).ok()?.place(path),
        }
    }
}

impl In<Any> {
    /// The newest sample, whether seen before or not; none while nothing was written or nobody is connected.
    pub fn latest(&mut self) -> Option<AnyView<'_>> {
        self.any_view(false)
    }

    /// Each sample once, in order (an input with `fifo`).
    #[allow(clippy::should_implement_trait)] // An input is no iterator: it may have more later.
    pub fn next(&mut self) -> Option<AnyView<'_>> {
        self.any_view(true)
    }

    fn any_view(&mut self, next: bool) -> Option<AnyView<'_>> {
        let view = self.view(next)?;
        // SAFETY: attach demands a valid slot, and the stub is static.
        let slot = unsafe { &*self.slot };
        let told = has_entry(slot.struct_size, offset_of!(InSlot, header_len), ENTRY);
        // SAFETY: the entry lies inside the slot; the context is its own.
        let len = if told { unsafe { (slot.header_len)(slot.ctx) } } else { 0 };
        Some(AnyView { view, len: len as usize, slot })
    }

    /// The connected type; none while unconnected. Allocates: not for `step`, where [`AnyView::place`] finds
    /// a number.
    pub fn ty(&self) -> Option<AnyType> {
        self.type_json().and_then(|text| AnyType::of_port(&text).ok())
    }

    /// The connected type as manifest JSON; none while unconnected.
    pub fn type_json(&self) -> Option<String> {
        // SAFETY: attach demands a valid slot, and the stub is static.
        unsafe { ask_type((*self.slot).type_of, (*self.slot).ctx) }
    }
}

impl Out<Any> {
    /// Publishes a plain value given as bytes of the connected type. An invalid stamp is replaced by the
    /// begin of this step. `InvalidArgument` when the size is not the type's, `Unbound` while unconnected,
    /// `Disabled` on a host older than ABI 1.1.
    pub fn write_bytes(&self, value: &[u8], stamp: Stamp) -> Outcome {
        // SAFETY: attach demands a valid slot, and the stub is static.
        let slot = unsafe { &*self.slot };
        if !has_entry(slot.struct_size, offset_of!(OutSlot, write_bytes), ENTRY) {
            return Outcome::Disabled;
        }
        let bytes = Bytes { ptr: value.as_ptr(), len: value.len() };
        // SAFETY: the entry lies inside the slot and compares the size; the bytes live through the call.
        Outcome::from(unsafe { (slot.write_bytes)(slot.ctx, bytes, self.stamp_or(stamp.ns())) })
    }

    /// The connected type; none while unconnected. Allocates.
    pub fn ty(&self) -> Option<AnyType> {
        self.type_json().and_then(|text| AnyType::of_port(&text).ok())
    }

    /// Publishes a received sample without a copy.
    pub fn forward(&mut self, sample: &AnyView<'_>) -> Outcome {
        // SAFETY: the view is held by its input through this call.
        let outcome = unsafe { ((*self.slot).forward)((*self.slot).ctx, &sample.view, sample.view.stamp_ns) };
        Outcome::from(outcome)
    }

    /// The connected type as manifest JSON; none while unconnected.
    pub fn type_json(&self) -> Option<String> {
        // SAFETY: attach demands a valid slot, and the stub is static.
        unsafe { ask_type((*self.slot).type_of, (*self.slot).ctx) }
    }
}

// SAFETY: hands out pointers only; the host ties it to any type.
unsafe impl Flow for In<Any> {
    type Slot = InSlot;
    const KIND: PortKind = PortKind::Any;
    unsafe fn attach(&mut self, slot: *const InSlot, tie: &Tie) {
        self.tie(slot, tie);
    }
}

// SAFETY: forwards host samples, or bytes whose size the host compares.
unsafe impl Flow for Out<Any> {
    type Slot = OutSlot;
    const KIND: PortKind = PortKind::Any;
    unsafe fn attach(&mut self, slot: *const OutSlot, tie: &Tie) {
        self.tie(slot, tie);
    }
}

/// A function that binds to any command.
pub struct AnyFunction {
    slot: *const FnSlot,
    lease: Option<Lease>,
}

// SAFETY: the host's slots take calls from several threads of one component.
unsafe impl Send for AnyFunction {}
// SAFETY: as above; the slot itself is immutable.
unsafe impl Sync for AnyFunction {}

impl Default for AnyFunction {
    fn default() -> Self {
        AnyFunction { slot: stubs::function(), lease: None }
    }
}

impl AnyFunction {
    /// The connected command's description as manifest JSON; none while unconnected.
    pub fn type_json(&self) -> Option<String> {
        // SAFETY: attach demands a valid slot, and the stub is static.
        unsafe { ask_type((*self.slot).type_of, (*self.slot).ctx) }
    }

    /// The connected command; none while unconnected. Allocates.
    pub fn command(&self) -> Option<AnyCommand> {
        self.type_json().and_then(|text| AnyCommand::of_function(&text).ok())
    }

    /// Sends without waiting and without a result; an empty slice for a command without argument.
    /// `InvalidArgument` when the size is not the argument's, `Disabled` on a host older than ABI 1.1.
    /// Allocates nothing: for `step`.
    pub fn send_bytes(&self, arg: &[u8]) -> Outcome {
        self.ask(arg, &mut [], core::ptr::null_mut())
    }

    /// Waits for the result, at most until the connection's deadline, and returns its bytes. Allocates.
    ///
    /// # Errors
    /// The outcome and the peer's sentence; `InvalidArgument` when the size is not the argument's.
    pub fn call_bytes(&self, arg: &[u8]) -> Result<Vec<u8>, CallError> {
        let command = self.command().ok_or_else(|| CallError::of(Outcome::Unbound))?;
        self.call_as(&command, arg)
    }

    /// Calls as [`AnyFunction::call_bytes`] does, with JSON; null stands for no argument and for no result.
    ///
    /// # Errors
    /// As `call_bytes`; the reason says where the value does not fit the argument's type.
    pub fn call_json(&self, arg: &Json) -> Result<Json, CallError> {
        let command = self.command().ok_or_else(|| CallError::of(Outcome::Unbound))?;
        let arg = match &command.arg {
            Some(ty) => ty.to_bytes(arg).map_err(|e| CallError {
                outcome: Outcome::InvalidArgument,
                reason: e.to_string(),
                may_still_run: false,
            })?,
            None => Vec::new(),
        };
        let ret = self.call_as(&command, &arg)?;
        Ok(command.ret.as_ref().and_then(|ty| ty.to_json(&ret)).unwrap_or_default())
    }

    /// Calls as [`AnyFunction::call_bytes`], with the result in `ret`, whose length has to be the result's.
    /// Allocates nothing, except for the sentence of a peer that refuses: for `step`.
    ///
    /// # Errors
    /// As `call_bytes`, and `InvalidArgument` when the length of `ret` is not the result's; what `ret` holds
    /// then is unknown.
    pub fn call_into(&self, arg: &[u8], ret: &mut [u8]) -> Result<(), CallError> {
        waiting(Duration::ZERO, |opts| self.ask(arg, ret, opts))
    }

    fn call_as(&self, command: &AnyCommand, arg: &[u8]) -> Result<Vec<u8>, CallError> {
        let mut ret = vec![0; command.ret_size()];
        self.call_into(arg, &mut ret)?;
        Ok(ret)
    }

    fn ask(&self, arg: &[u8], ret: &mut [u8], opts: *mut CallOpts) -> Outcome {
        // SAFETY: attach demands a valid slot, and the stub is static.
        let slot = unsafe { &*self.slot };
        if !has_entry(slot.struct_size, offset_of!(FnSlot, call_bytes), ENTRY) {
            return Outcome::Disabled;
        }
        let len = ret.len() as u64;
        // The server reads its argument and writes its result in place.
        let called = aligned::writing(ret, |to| {
            let to = if len > 0 { to.cast() } else { core::ptr::null_mut() };
            aligned::reading(arg, |from| {
                let bytes = Bytes { ptr: from, len: arg.len() };
                // SAFETY: the entry lies inside the slot and compares both sizes; all pointers live through
                // the call.
                Outcome::from(unsafe { (slot.call_bytes)(slot.ctx, bytes, to, len, opts) })
            })
        });
        called.flatten().unwrap_or(Outcome::InvalidArgument)
    }
}

impl FunctionPort for AnyFunction {
    const ARG: Option<&'static TypeDesc> = None;
    const RET: Option<&'static TypeDesc> = None;
    const ANY: bool = true;
}

// SAFETY: the host ties it to any command and compares the sizes of each call.
unsafe impl Flow for AnyFunction {
    type Slot = FnSlot;
    const KIND: PortKind = PortKind::Any;
    unsafe fn attach(&mut self, slot: *const FnSlot, tie: &Tie) {
        self.slot = slot;
        self.lease = Some(tie.lease.clone());
    }
}

/// # Safety
/// `type_of` and `ctx` belong to one valid slot.
unsafe fn ask_type(
    type_of: unsafe extern "C" fn(*mut c_void, *const Sink) -> Status,
    ctx: *mut c_void,
) -> Option<String> {
    unsafe extern "C" fn write(ctx: *mut c_void, bytes: Bytes) {
        // SAFETY: `ctx` is the vector below; the callee passes readable bytes.
        unsafe {
            let text = &mut *ctx.cast::<Vec<u8>>();
            if !bytes.ptr.is_null() {
                text.extend_from_slice(core::slice::from_raw_parts(bytes.ptr, bytes.len));
            }
        }
    }
    let mut text: Vec<u8> = Vec::new();
    let sink = Sink { ctx: (&raw mut text).cast(), write };
    // SAFETY: the sink lives through the call.
    let status = unsafe { type_of(ctx, &sink) };
    (status == STATUS_OK).then(|| String::from_utf8_lossy(&text).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_plugin_api::abi::SAMPLE_FRESH;

    #[test]
    fn a_host_without_the_entry_is_not_asked_to_hold() {
        unsafe extern "C" fn hold(_: *mut c_void, _: *mut Held) -> i32 {
            std::process::abort()
        }
        // SAFETY: the stub is static.
        let stub = unsafe { core::ptr::read(stubs::input()) };
        let slot = InSlot { struct_size: offset_of!(InSlot, hold) as u32, hold, ..stub };
        let view = SampleView { flags: SAMPLE_FRESH, seq: 1, ..SampleView::EMPTY };
        assert!(AnyView { view, len: 0, slot: &slot }.hold().is_none());
    }
}
