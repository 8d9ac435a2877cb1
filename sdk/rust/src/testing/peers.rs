//! Fake peers: they answer functions, call commands and reads, emit and observe events.
//!
//! Invariant: types are checked against the description before a byte is moved.

use super::bench::{Bench, Done, Failure, Life};
use super::limits;
use super::member_cells::Answer;
use super::shape::{Member, Of};
use crate::call::Value;
use crate::class::Class;
use crate::outcome::Outcome;
use trocar_plugin_api::abi;
use trocar_plugin_api::desc::Safety;

impl<C: Class> Bench<C> {
    /// Cuts or restores the connection of a function; `function` or `interface/function`.
    #[track_caller]
    pub fn connect_function(&mut self, function: &str, connected: bool) {
        let at = self.shape.member(Of::Functions, function).id;
        self.functions[at].get().connected = connected;
    }

    /// Takes the peer of a required interface away: its functions answer UNBOUND, and an actuator is made
    /// safe and stands still until `resume`, as with a host.
    ///
    /// # Errors
    /// The component's sentence.
    #[track_caller]
    pub fn lose_peer(&mut self, interface: &str) -> Done {
        let functions = self.shape.members(Of::Functions);
        let lost = functions.iter().filter(|m| m.path.split_once('/').is_some_and(|(i, _)| i == interface));
        let lost: Vec<usize> = lost.map(|m| m.id).collect();
        let there: Vec<&str> = self.shape.class().required.iter().map(|r| r.name.as_str()).collect();
        assert!(
            !lost.is_empty(),
            "no required interface `{interface}` with functions; there are {}",
            there.join(", ")
        );
        for at in lost {
            self.functions[at].get().connected = false;
        }
        self.history.note(self.now().ns(), format!("peer of {interface} lost"));
        if C::DESC.safety == Safety::Actuator && self.life() == Life::Active {
            self.halt()?;
        }
        Ok(())
    }

    /// The arguments a function was called with since the last asking; `function` or `interface/function`.
    #[track_caller]
    pub fn calls<A: Value>(&mut self, function: &str) -> Vec<A> {
        let m = self.shape.member(Of::Functions, function);
        self.expect_function(&m, A::DESC, None);
        let cell = self.functions[m.id].get();
        cell.told = 0;
        std::mem::take(&mut cell.calls).iter().map(|bytes| value(bytes)).collect()
    }

    /// Lets a fake peer answer a function, inline. An error text becomes the outcome FAILED. It connects an
    /// untyped function to a command of these types.
    #[track_caller]
    pub fn answer<A: Value, R: Value>(
        &mut self,
        function: &str,
        mut f: impl FnMut(A) -> Result<R, String> + 'static,
    ) {
        let m = self.shape.member(Of::Functions, function);
        if m.any {
            self.connect_as_command::<A, R>(function);
        }
        self.expect_function(&m, A::DESC, Some(R::DESC));
        let answer: Answer = Box::new(move |arg| match f(value(arg)) {
            Ok(ret) => Ok(value_bytes(&ret)),
            Err(reason) => Err((abi::FAILED, reason)),
        });
        self.functions[m.id].get().answer = Some(answer);
    }

    /// Lets every call of a function end with `outcome`, until `answer` or another `fail`: QUEUE_FULL,
    /// DEADLINE, PEER_LOST … `Outcome::Queued` and `Outcome::Executed` make it well again.
    #[track_caller]
    pub fn fail(&mut self, function: &str, outcome: Outcome) {
        let at = self.shape.member(Of::Functions, function).id;
        let code = code(outcome);
        let answer: Answer = Box::new(move |_| Err((code, format!("the bench answers {outcome:?}"))));
        self.functions[at].get().answer = (!outcome.is_ok()).then_some(answer);
    }

    /// Fills the queues of an event's observers (or gives them room again): `emit` tells, the event is
    /// recorded all the same.
    #[track_caller]
    pub fn overflow(&mut self, event: &str, full: bool) {
        let at = self.shape.member(Of::Events, event).id;
        self.events[at].get().full = full;
    }

    /// Everything an event emitted since the last asking; `event` or `interface/event`.
    #[track_caller]
    pub fn events<T: Value>(&mut self, event: &str) -> Vec<T> {
        let m = self.shape.member(Of::Events, event);
        self.shape.expect_type("event", event, m.arg.as_ref(), T::DESC);
        let cell = self.events[m.id].get();
        cell.told = 0;
        std::mem::take(&mut cell.emitted).iter().map(|bytes| value(bytes)).collect()
    }

    /// Executes a command; `command` or `interface/command`. `()` stands for no argument and for no result.
    ///
    /// # Errors
    /// The component's sentence; after a panic it is in FAULT. Or the component is not ACTIVE, or the
    /// argument not within its declared limits; then the component was not entered.
    #[track_caller]
    pub fn command<A: Value, R: Value>(&mut self, command: &str, arg: A) -> Result<R, Failure> {
        let m = self.command_of::<A, R>(command, false);
        self.history.note(self.now().ns(), format!("command {}", m.path));
        within(&m, &arg)?;
        self.allow_active(&m.path)?;
        let (f, mut ret) = (self.table.command, R::blank());
        let (id, result) = (m.id as u32, ret.ptr_mut());
        let done = self.enter(|this, err| match f {
            // SAFETY: a live instance; argument and result have the types of the description, checked above.
            Some(f) => unsafe { f(this, id, arg.ptr(), result, err) },
            None => abi::STATUS_UNSUPPORTED,
        });
        let done = self.survived(&format!("command {}", m.path), done);
        self.reply_all();
        done.map(|()| ret)
    }

    /// Executes a read on the row published last.
    ///
    /// # Errors
    /// As [`Bench::command`].
    #[track_caller]
    pub fn read<A: Value, R: Value>(&self, read: &str, arg: A) -> Result<R, Failure> {
        let m = self.command_of::<A, R>(read, true);
        within(&m, &arg)?;
        let mut ret = R::blank();
        let (row, result) = ((&raw const self.row).cast(), ret.ptr_mut());
        self.entry(|_, err| match self.table.read {
            // SAFETY: the row is this class's; argument and result have the types of the description, checked
            // above.
            Some(f) => unsafe { f(row, m.id as u32, arg.ptr(), result, err) },
            None => abi::STATUS_UNSUPPORTED,
        })?;
        Ok(ret)
    }

    #[track_caller]
    fn command_of<A: Value, R: Value>(&self, name: &str, is_read: bool) -> Member {
        let m = self.shape.member(Of::Commands, name);
        assert!(m.is_read == is_read, "`{name}`: reads go with `read`, the other kinds with `command`");
        self.shape.expect_type("argument of", name, m.arg.as_ref(), A::DESC);
        self.shape.expect_type("result of", name, m.ret.as_ref(), R::DESC);
        m
    }

    /// Lets the connected peer emit an event of a required interface; `event` or `interface/event`.
    ///
    /// # Errors
    /// The component's sentence; after a panic it is in FAULT. Or the component is not ACTIVE: then no
    /// handler runs.
    #[track_caller]
    pub fn emit<T: Value>(&mut self, event: &str, payload: T) -> Done {
        let m = self.shape.member(Of::Handlers, event);
        self.shape.expect_type("handler", event, m.arg.as_ref(), T::DESC);
        self.history.note(self.now().ns(), format!("peer emits {}", m.path));
        self.allow_active(&m.path)?;
        let (f, id) = (self.table.on_event, m.id as u32);
        let done = self.enter(|this, err| match f {
            // SAFETY: a live instance; the payload has the type of the description, checked above.
            Some(f) => unsafe { f(this, id, payload.ptr(), err) },
            None => abi::STATUS_UNSUPPORTED,
        });
        let done = self.survived(&format!("handler {}", m.path), done);
        self.reply_all();
        done
    }
}

/// # Errors
/// The argument is not within its declared limits.
fn within<A: Value>(m: &Member, arg: &A) -> Done {
    let Some(limited) = &m.limited else { return Ok(()) };
    limits::check(limited, &value_bytes(arg))
        .map_err(|reason| Failure { status: abi::STATUS_INVALID, reason })
}

pub(crate) fn code(outcome: Outcome) -> abi::Outcome {
    match outcome {
        Outcome::Executed => abi::EXECUTED,
        Outcome::Queued => abi::QUEUED,
        Outcome::Unbound => abi::UNBOUND,
        Outcome::QueueFull => abi::QUEUE_FULL,
        Outcome::WouldBlock => abi::WOULD_BLOCK,
        Outcome::Disabled => abi::DISABLED,
        Outcome::InvalidArgument => abi::INVALID_ARGUMENT,
        Outcome::Failed => abi::FAILED,
        Outcome::Deadline => abi::DEADLINE,
        Outcome::PeerLost => abi::PEER_LOST,
        Outcome::NotActive => abi::NOT_ACTIVE,
        Outcome::Exhausted => abi::EXHAUSTED,
        Outcome::Other(code) => code,
    }
}

/// A value from recorded bytes; none are recorded for `()`.
fn value<T: Value>(bytes: &[u8]) -> T {
    let mut value = T::blank();
    if bytes.len() == size_of::<T>() && !bytes.is_empty() {
        // SAFETY: the length is the value's, and `ptr_mut` points to it.
        unsafe { core::ptr::copy_nonoverlapping(bytes.as_ptr(), value.ptr_mut().cast(), bytes.len()) };
    }
    value
}

fn value_bytes<T: Value>(value: &T) -> Vec<u8> {
    if size_of::<T>() == 0 {
        return Vec::new();
    }
    // SAFETY: a value is a payload, whose bytes are all initialised.
    unsafe { core::slice::from_raw_parts(value.ptr().cast::<u8>(), size_of::<T>()).to_vec() }
}
