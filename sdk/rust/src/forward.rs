//! Log lines and panics of this library, forwarded to the host.
//!
//! Invariant: `log` and the panic hook are statics of each `.so`; `install` runs in this one and never fails
//! a load.

use core::fmt::Write;
use std::any::Any;
use std::cell::RefCell;
use std::panic::PanicHookInfo;
use std::sync::Once;
use std::sync::atomic::{AtomicPtr, Ordering};
use trocar_plugin_api::abi::{
    Bytes, HOST_LINKED, HostTable, LOG_DEBUG, LOG_ERROR, LOG_INFO, LOG_TRACE, LOG_WARN,
};

static HOST: AtomicPtr<HostTable> = AtomicPtr::new(core::ptr::null_mut());
static HOOK: Once = Once::new();

thread_local! {
    static LAST_PANIC: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Longest forwarded line, bytes; the rest is cut. Lines are formatted on the stack, so `step` may log.
const LINE: usize = 512;

/// Remembers the host and installs logger and hook, once per library. In the host's own program, lines go to
/// the program's own logger, and the program's panic hook keeps reporting.
pub(crate) fn install(host: *const HostTable) {
    // SAFETY: `init` demands a table that is null or valid.
    if unsafe { host.as_ref() }.is_some_and(|host| host.flags & HOST_LINKED != 0) {
        return install_hook();
    }
    HOST.store(host.cast_mut(), Ordering::Release);
    // An existing logger (a statically linked program's) is not ours to replace.
    if log::set_logger(&Forwarder).is_ok() {
        log::set_max_level(log::LevelFilter::Info);
    }
    install_hook();
}

/// The same for a component on a bench: no host; lines are kept for the test.
pub(crate) fn install_for_tests() {
    if log::set_logger(&Forwarder).is_ok() {
        log::set_max_level(log::LevelFilter::Info);
    }
    install_hook();
}

/// Remembers where a thread panicked; without a host, the former hook speaks too.
pub(crate) fn install_hook() {
    HOOK.call_once(|| {
        let previous = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            let text = describe(info);
            if !send(LOG_ERROR, "panic", &text) {
                previous(info);
            }
            LAST_PANIC.with(|p| {
                if let Ok(mut p) = p.try_borrow_mut() {
                    *p = Some(text);
                }
            });
        }));
    });
}

/// "panicked at src/lib.rs:42: message" of this thread's latest panic.
pub(crate) fn last_panic() -> Option<String> {
    LAST_PANIC.with(|p| p.try_borrow_mut().ok()?.take())
}

/// The message of a panic's payload.
pub(crate) fn payload_text(payload: &(dyn Any + Send)) -> &str {
    match payload.downcast_ref::<&str>() {
        Some(text) => text,
        None => payload.downcast_ref::<String>().map_or("a value that is no text", String::as_str),
    }
}

fn describe(info: &PanicHookInfo<'_>) -> String {
    let text = payload_text(info.payload());
    match info.location() {
        Some(at) => format!("panicked at {}:{}: {text}", at.file(), at.line()),
        None => format!("panicked: {text}"),
    }
}

/// False when there is no host to send to.
fn send(level: u32, target: &str, message: &str) -> bool {
    let host = HOST.load(Ordering::Acquire);
    // SAFETY: `init` demands a table that lives as long as the library.
    let Some(host) = (unsafe { host.as_ref() }) else { return false };
    let bytes = |text: &str| Bytes { ptr: text.as_ptr(), len: text.len() };
    // SAFETY: any thread may log, and both texts live through the call.
    unsafe { (host.log)(host.ctx, level, bytes(target), bytes(message)) };
    true
}

struct Forwarder;

impl log::Log for Forwarder {
    fn enabled(&self, _: &log::Metadata<'_>) -> bool {
        true
    }

    fn log(&self, record: &log::Record<'_>) {
        let level = match record.level() {
            log::Level::Error => LOG_ERROR,
            log::Level::Warn => LOG_WARN,
            log::Level::Info => LOG_INFO,
            log::Level::Debug => LOG_DEBUG,
            log::Level::Trace => LOG_TRACE,
        };
        let mut line = Line { text: [0; LINE], len: 0 };
        // A cut line is still worth sending.
        let _ = write!(line, "{}", record.args());
        let text = core::str::from_utf8(&line.text[..line.len]).unwrap_or("");
        if !send(level, record.target(), text) {
            crate::testing::keep(record.level(), record.target(), text);
        }
    }

    fn flush(&self) {}
}

/// A line on the stack, cut between characters.
struct Line {
    text: [u8; LINE],
    len: usize,
}

impl Write for Line {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        let mut end = text.len().min(LINE - self.len);
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        self.text[self.len..self.len + end].copy_from_slice(&text.as_bytes()[..end]);
        self.len += end;
        if end == text.len() { Ok(()) } else { Err(core::fmt::Error) }
    }
}
