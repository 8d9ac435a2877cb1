//! Reads of a server in another process that are answered in this process, because the code of its class is
//! here, too.
//!
//! Invariant: a row is copied and made a valid value of the state's type before the class sees it, whatever
//! bits it had; the number the other process gives a read is used only where argument and result of that
//! number fit.

use std::mem::MaybeUninit;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use trocar_loader::convert::MAX_PAYLOAD;
use trocar_model::{ClassInfo, Command, Ports};
use trocar_plugin_api::abi::{DISABLED, ErrBuf, NOT_ACTIVE, Outcome, STATUS_PANICKED};
use trocar_rt::segment::Word;
use trocar_rt::state::StateReader;

use super::super::books::LastWords;
use super::class::LoadedClass;
use super::hot::{Hot, Read};
use super::mend::Mend;
use super::outcomes::outcome_of;
use super::row::{bytes_of, with_row};
use super::texts::sentence;

/// A class that both this process and another one have.
pub(crate) struct OwnClass {
    pub(crate) info: Arc<ClassInfo>,
    pub(crate) class: LoadedClass,
}

/// The rows of one server, and the code that computes reads from them.
pub(crate) struct OwnRows {
    read: Read,
    rows: StateReader,
    mend: Mend,
    panics: Arc<Panics>,
    /// Keeps the code loaded.
    _class: LoadedClass,
}

impl OwnRows {
    pub(crate) fn new(own: &OwnClass, rows: StateReader, panics: Arc<Panics>) -> Arc<OwnRows> {
        Arc::new(OwnRows {
            read: Hot::of(own.class.table()).read,
            rows,
            mend: own.info.ports.state.as_ref().map_or_else(Mend::default, Mend::of),
            panics,
            _class: own.class.clone(),
        })
    }
}

/// Reads that panicked here, kept for the process of their server.
#[derive(Default)]
pub(crate) struct Panics {
    count: AtomicU64,
    last: LastWords,
}

impl Panics {
    #[cold]
    fn add(&self, name: &str, err: *mut ErrBuf) {
        self.last.put(format!("{name}: {}", sentence(err)).as_bytes());
        self.count.fetch_add(1, Ordering::Release);
    }

    /// Returns how many reads panicked so far, and the sentence of the last panic.
    pub(crate) fn so_far(&self) -> (u64, String) {
        (self.count.load(Ordering::Acquire), self.last.get())
    }
}

/// Possible use of a number that the server's process gives a read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fit {
    /// The number is that of another command.
    No,
    /// The server's process once said that the number has this argument and this result: the call gets room
    /// for any.
    Told,
    /// The manifest of the class says that the number has this argument and this result.
    Sure,
}

/// A read of a server in another process.
pub(crate) struct OwnRead {
    rows: Arc<OwnRows>,
    /// Number of the read in the server's description: see [`trocar_rt::segment::Calls`].
    at: Word,
    fits: Box<[Fit]>,
    name: String,
    arg_bytes: usize,
    ret_bytes: usize,
}

fn own_commands(ports: &Ports) -> impl Iterator<Item = &Command> {
    let own = ports.provided.len().saturating_sub(1);
    ports.provided[..own].iter().flat_map(|provided| &provided.commands)
}

fn alike(a: &Command, b: &Command) -> bool {
    let args = match (&a.arg, &b.arg) {
        (Some(a), Some(b)) => a.ty.same(&b.ty),
        (None, None) => true,
        _ => false,
    };
    let results = match (&a.ret, &b.ret) {
        (Some(a), Some(b)) => a.same(b),
        (None, None) => true,
        _ => false,
    };
    a.kind == b.kind && args && results
}

fn fits(command: &Command, class: &Ports, told: &Ports) -> Box<[Fit]> {
    // A class that describes itself may give its numbers another meaning than its manifest does.
    let same = |(a, b): (&Command, &Command)| a.name == b.name && alike(a, b);
    let (of_class, of_told) = (own_commands(class), own_commands(told));
    let same = class.provided.len() == told.provided.len() && of_class.zip(of_told).all(same);
    let same = same && own_commands(class).count() == own_commands(told).count();
    let fit = if same { Fit::Sure } else { Fit::Told };
    own_commands(told).map(|other| if alike(command, other) { fit } else { Fit::No }).collect()
}

impl OwnRead {
    /// `told` are the server's ports as its process has described them.
    pub(crate) fn new(
        rows: &Arc<OwnRows>,
        at: Word,
        command: &Command,
        own: &OwnClass,
        told: &Ports,
    ) -> OwnRead {
        OwnRead {
            rows: rows.clone(),
            at,
            fits: fits(command, &own.info.ports, told),
            name: command.name.clone(),
            arg_bytes: command.arg.as_ref().map_or(0, |arg| arg.ty.size()),
            ret_bytes: command.ret.as_ref().map_or(0, trocar_model::Type::size),
        }
    }

    /// Returns outcome and stamp; `None` where the server's process has to be asked. Any thread, never waits;
    /// `arg` and `ret` are present where the command has them.
    pub(super) fn call(&self, arg: *const u8, ret: *mut u8, err: *mut ErrBuf) -> Option<(Outcome, u64)> {
        let Some(id) = self.at.get().checked_sub(1) else { return Some((DISABLED, 0)) };
        let fit = usize::try_from(id).ok().and_then(|id| self.fits.get(id)).copied().unwrap_or(Fit::No);
        let id = id as u32;
        match fit {
            Fit::No => None,
            Fit::Sure => Some(self.answer(id, arg, ret, err)),
            Fit::Told => Some(self.answer_with_room(id, arg, ret, err)),
        }
    }

    #[inline]
    fn answer(&self, id: u32, arg: *const u8, ret: *mut u8, err: *mut ErrBuf) -> (Outcome, u64) {
        let own = &*self.rows;
        let row_bytes = own.rows.row_bytes();
        with_row(row_bytes, |row| {
            let bytes = bytes_of(row, row_bytes);
            let Some(info) = own.rows.latest(bytes) else { return (NOT_ACTIVE, 0) };
            own.mend.mend(bytes);
            // SAFETY: the row has the size and alignment of the class's state type and is a value of it; arg
            // and ret are of the types of the command with this number, or have room for any; the entry takes
            // no instance.
            let status = unsafe { (own.read)(row.as_ptr().cast(), id, arg.cast(), ret.cast(), err) };
            if status == STATUS_PANICKED {
                own.panics.add(&self.name, err);
            }
            (outcome_of(status, err), info.stamp_ns)
        })
    }

    /// As `answer`, with a copy of the argument and a place for the result that have room for those of any
    /// command.
    #[inline(never)]
    fn answer_with_room(&self, id: u32, arg: *const u8, ret: *mut u8, err: *mut ErrBuf) -> (Outcome, u64) {
        let mut large = [0u64; MAX_PAYLOAD / 8];
        let mut place = MaybeUninit::<[u64; MAX_PAYLOAD / 8]>::uninit();
        let (from, to) = (large.as_mut_ptr().cast::<u8>(), place.as_mut_ptr().cast::<u8>());
        if self.arg_bytes > 0 {
            // SAFETY: an argument of the command's type, which is no longer than any payload; the copy is
            // this function's own.
            unsafe { std::ptr::copy_nonoverlapping(arg, from, self.arg_bytes) };
        }
        // SAFETY: as above; the bytes copied out below have a value, whatever the class writes.
        unsafe { to.write_bytes(0, self.ret_bytes) };
        let answered = self.answer(id, from, to, err);
        if self.ret_bytes > 0 {
            // SAFETY: the caller's place for the command's result; at least that many bytes were written
            // above.
            unsafe { std::ptr::copy_nonoverlapping(to, ret, self.ret_bytes) };
        }
        answered
    }
}

#[cfg(test)]
mod tests;
