//! Commands, reads and events from ids and pointers to typed methods.
//!
//! Invariant: the types a description names and the types a dispatch uses come from the same tokens of the
//! same method.

use crate::guard;
use crate::payload::Payload;
use core::ffi::c_void;
use core::fmt::Display;
use trocar_plugin_api::abi::{self, ErrBuf, Status};
use trocar_plugin_api::desc::{CommandKind, TypeDesc};

/// A payload or `()`: the argument or result of a command.
///
/// # Safety
/// `DESC` is none exactly for zero-sized `()`, and the pointers point to a value of the described type.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no payload: a command, function or event cannot carry it",
    label = "not plain data of a fixed layout",
    note = "instead of `bool` write `Flag`, of `String` `Text<N>`, of `Vec<T>` `List<T, N>`, of an enum `named_values!`, of \
            `usize` `u64`",
    note = "a struct of one's own needs `#[derive(Payload, Clone, Copy)] #[repr(C)]`"
)]
pub unsafe trait Value: Copy + Send + Sync + 'static {
    /// The description of the type; none for `()`.
    const DESC: Option<&'static TypeDesc>;
    /// A value to be written over.
    fn blank() -> Self;
    #[doc(hidden)]
    fn ptr(&self) -> *const c_void;
    #[doc(hidden)]
    fn ptr_mut(&mut self) -> *mut c_void;
}

// SAFETY: described by the payload itself, and the pointers are the value's own.
unsafe impl<T: Payload> Value for T {
    const DESC: Option<&'static TypeDesc> = Some(T::DESC);
    #[inline]
    fn blank() -> T {
        T::zeroed()
    }
    #[inline]
    fn ptr(&self) -> *const c_void {
        (self as *const T).cast()
    }
    #[inline]
    fn ptr_mut(&mut self) -> *mut c_void {
        (self as *mut T).cast()
    }
}

// SAFETY: nothing is described and nothing is pointed to.
unsafe impl Value for () {
    const DESC: Option<&'static TypeDesc> = None;
    #[inline]
    fn blank() {}
    #[inline]
    fn ptr(&self) -> *const c_void {
        core::ptr::null()
    }
    #[inline]
    fn ptr_mut(&mut self) -> *mut c_void {
        core::ptr::null_mut()
    }
}

/// Result of a command or read: a value, nothing, or a `Result` of these with an error that can be shown.
pub trait Answer {
    /// The value that travels to the caller; `()` for none.
    type Value: Value;
    #[doc(hidden)]
    fn settle(self) -> Result<Self::Value, impl Display>;
}

impl<T: Payload> Answer for T {
    type Value = T;
    #[inline]
    fn settle(self) -> Result<T, impl Display> {
        Ok::<T, &str>(self)
    }
}

impl Answer for () {
    type Value = ();
    #[inline]
    fn settle(self) -> Result<(), impl Display> {
        Ok::<(), &str>(())
    }
}

impl<V: Value, E: Display> Answer for Result<V, E> {
    type Value = V;
    #[inline]
    fn settle(self) -> Result<V, impl Display> {
        self
    }
}

/// The kind that a signature makes.
pub const fn kind_of<A: Value, R: Answer>(is_read: bool) -> CommandKind {
    match (is_read, A::DESC.is_some(), R::Value::DESC.is_some()) {
        (true, false, _) => CommandKind::Read,
        (true, true, _) => CommandKind::QualifiedRead,
        (false, false, false) => CommandKind::Void,
        (false, true, false) => CommandKind::Write,
        (false, false, true) => CommandKind::VoidReturn,
        (false, true, true) => CommandKind::WriteReturn,
    }
}

/// One call as it came through the table.
pub struct Call {
    arg: *const c_void,
    ret: *mut c_void,
    err: *mut ErrBuf,
}

impl Call {
    /// # Safety
    /// `arg` points to a value of the id's argument type or is null when it has none, `ret` to room for its
    /// return value or is null when nobody wants it, `err` to an error buffer or is null; all for the whole
    /// call.
    #[inline]
    pub(crate) unsafe fn new(arg: *const c_void, ret: *mut c_void, err: *mut ErrBuf) -> Call {
        Call { arg, ret, err }
    }

    /// Reads the argument, runs `f`, writes the answer.
    ///
    /// # Safety
    /// `A` and `R::Value` are the types that the class description names for this id.
    #[inline]
    pub unsafe fn run<A: Value, R: Answer>(&mut self, f: impl FnOnce(A) -> R) -> Status {
        let arg = if size_of::<A>() == 0 {
            A::blank()
        } else if self.arg.is_null() {
            return guard::refuse(self.err, abi::STATUS_INVALID, &"the call carries no argument");
        } else {
            // SAFETY: `new` demands a value of the described type, which is `A` by this function's contract.
            unsafe { self.arg.cast::<A>().read_unaligned() }
        };
        match f(arg).settle() {
            Ok(value) => {
                if size_of::<R::Value>() != 0 && !self.ret.is_null() {
                    // SAFETY: `new` demands room for a value of the described type, which is `R::Value`.
                    unsafe { self.ret.cast::<R::Value>().write_unaligned(value) };
                }
                abi::STATUS_OK
            }
            Err(e) => guard::refuse(self.err, abi::STATUS_FAILED, &e),
        }
    }

    /// The answer to an id the class does not have.
    #[cold]
    pub fn unknown(&mut self, id: u32) -> Status {
        guard::refuse(
            self.err,
            abi::STATUS_UNSUPPORTED,
            &format_args!("this class has no command or handler with the relative id {id}"),
        )
    }
}
