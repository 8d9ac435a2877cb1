//! Ports without a type of their own: they take that of what they are connected to (recorder, player, bridges).
//!
//! Invariant: raw access is bounded by what the caller says it has; interpreting the bytes needs `type_json`.

use crate::call::Value;
use crate::function::FunctionPort;
use crate::host::Host;
use crate::outcome::Outcome;
use crate::ports::{Flow, In, Out, PortKind};
use crate::stubs;
use crate::values::Stamp;
use core::ffi::c_void;
use trocar_plugin_api::abi::{Bytes, FnSlot, InSlot, OutSlot, STATUS_OK, SampleView, Sink, Status};
use trocar_plugin_api::desc::TypeDesc;

/// Marks an untyped port.
pub struct Any(());

/// An input that takes any type.
pub type AnyIn = In<Any>;
/// An output that takes any type.
pub type AnyOut = Out<Any>;

/// A sample of unknown type.
pub struct AnyView<'a> {
    view: SampleView,
    input: core::marker::PhantomData<&'a mut ()>,
}

impl AnyView<'_> {
    /// The plain value or the header of a frame; its size is that of the type in `type_json`.
    pub fn header(&self) -> *const c_void {
        self.view.header
    }

    /// The bytes of a frame, empty for plain samples.
    pub fn bytes(&self) -> &[u8] {
        if self.view.bytes.is_null() {
            return &[];
        }
        // SAFETY: the slot gives `len` readable bytes while the view borrows the input.
        unsafe { core::slice::from_raw_parts(self.view.bytes, self.view.len as usize) }
    }

    pub fn stamp(&self) -> Stamp {
        Stamp::from_ns(self.view.stamp_ns)
    }

    pub fn seq(&self) -> u64 {
        self.view.seq
    }
}

impl In<Any> {
    pub fn latest(&mut self) -> Option<AnyView<'_>> {
        self.view(false).map(|view| AnyView { view, input: core::marker::PhantomData })
    }

    #[allow(clippy::should_implement_trait)] // An input is no iterator: it may have more later.
    pub fn next(&mut self) -> Option<AnyView<'_>> {
        self.view(true).map(|view| AnyView { view, input: core::marker::PhantomData })
    }

    /// The connected type as manifest JSON; none while unconnected.
    pub fn type_json(&self) -> Option<String> {
        // SAFETY: attach demands a valid slot, and the stub is static.
        unsafe { ask_type((*self.slot).type_of, (*self.slot).ctx) }
    }
}

impl Out<Any> {
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
    unsafe fn attach(&mut self, slot: *const InSlot, _: &Host) {
        self.slot = slot;
    }
}

// SAFETY: forwards host samples only; the host ties it to any type.
unsafe impl Flow for Out<Any> {
    type Slot = OutSlot;
    const KIND: PortKind = PortKind::Any;
    unsafe fn attach(&mut self, slot: *const OutSlot, host: &Host) {
        self.tie(slot, host);
    }
}

/// A function that binds to any command.
pub struct AnyFunction {
    slot: *const FnSlot,
}

// SAFETY: the host's slots take calls from several threads of one component.
unsafe impl Send for AnyFunction {}
// SAFETY: as above; the slot itself is immutable.
unsafe impl Sync for AnyFunction {}

impl Default for AnyFunction {
    fn default() -> Self {
        AnyFunction { slot: stubs::function() }
    }
}

impl AnyFunction {
    /// The connected command's description as manifest JSON; none while unconnected.
    pub fn type_json(&self) -> Option<String> {
        // SAFETY: attach demands a valid slot, and the stub is static.
        unsafe { ask_type((*self.slot).type_of, (*self.slot).ctx) }
    }

    /// Sends an argument of the connected command's type.
    ///
    /// # Safety
    /// `A` has exactly the layout that [`AnyFunction::type_json`] describes now.
    pub unsafe fn send<A: Value>(&self, arg: A) -> Outcome {
        // SAFETY: the caller vouches for the layout; the argument lives through the call.
        unsafe {
            let slot = &*self.slot;
            let (ret, opts) = (core::ptr::null_mut(), core::ptr::null_mut());
            Outcome::from((slot.call)(slot.ctx, arg.ptr(), ret, opts))
        }
    }
}

impl FunctionPort for AnyFunction {
    const ARG: Option<&'static TypeDesc> = None;
    const RET: Option<&'static TypeDesc> = None;
    const ANY: bool = true;
}

// SAFETY: the host ties it to any command; sending is the caller's own proof.
unsafe impl Flow for AnyFunction {
    type Slot = FnSlot;
    const KIND: PortKind = PortKind::Any;
    unsafe fn attach(&mut self, slot: *const FnSlot, _: &Host) {
        self.slot = slot;
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
