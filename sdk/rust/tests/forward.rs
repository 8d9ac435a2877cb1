//! Log lines and panics of a plugin reach the host's log.
//!
//! Invariant: the only test of its file, because logger and panic hook belong to the whole process.
#![allow(clippy::unwrap_used)]

use std::ffi::c_void;
use std::sync::Mutex;
use trocar_plugin_api::abi::{Bytes, EXECUTED, HostTable, LOG_ERROR, LOG_WARN, Outcome};
use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

static LINES: Mutex<Vec<(u32, String, String)>> = Mutex::new(Vec::new());

unsafe extern "C" fn log_line(_: *mut c_void, level: u32, target: Bytes, message: Bytes) {
    let text = |b: Bytes| {
        // SAFETY: both texts are readable during the call.
        let bytes = unsafe { std::slice::from_raw_parts(b.ptr, b.len) };
        std::str::from_utf8(bytes).unwrap().to_string()
    };
    LINES.lock().unwrap().push((level, text(target), text(message)));
}
unsafe extern "C" fn now_ns(_: *mut c_void) -> u64 {
    1
}
unsafe extern "C" fn service(_: *mut c_void, _: u64, _: Bytes) -> Outcome {
    EXECUTED
}
unsafe extern "C" fn enter(_: *mut c_void) -> Outcome {
    EXECUTED
}
unsafe extern "C" fn leave(_: *mut c_void) {}
unsafe extern "C" fn extension(_: *mut c_void, _: Bytes) -> *const c_void {
    std::ptr::null()
}

#[derive(Component)]
#[component(rate_hz = 10)]
struct Talker {
    #[state]
    steps: u32,
}

impl Component for Talker {
    fn step(&mut self, _: &Tick) -> Result {
        self.steps += 1;
        log::warn!("step {} is {}", self.steps, "µ".repeat(400));
        log::debug!("not wanted");
        assert!(self.steps < 2, "enough");
        Ok(())
    }
}

#[test]
fn warnings_and_panics_are_forwarded_and_long_lines_cut() {
    let host: &'static HostTable = Box::leak(Box::new(HostTable {
        struct_size: size_of::<HostTable>() as u32,
        flags: 0,
        abi_major: 1,
        abi_minor: 0,
        ctx: std::ptr::null_mut(),
        now_ns,
        log: log_line,
        service,
        callback_enter: enter,
        callback_leave: leave,
        extension,
        ports_changed: enter,
    }));
    // SAFETY: the table is leaked, so it lives as long as the process.
    unsafe { trocar_sdk::__private::init(host) };
    let mut bench = Bench::<Talker>::new("{}");
    bench.step(1);
    assert!(bench.try_step().unwrap_err().panicked());
    let lines = LINES.lock().unwrap();
    let levels: Vec<u32> = lines.iter().map(|l| l.0).collect();
    assert_eq!(levels, [LOG_WARN, LOG_WARN, LOG_ERROR]);
    let (_, target, message) = &lines[0];
    assert!(target == "forward" && message.starts_with("step 1 is µ") && message.len() <= 512, "{message}");
    assert!(lines[2].2.starts_with("panicked at ") && lines[2].2.ends_with("enough"), "{}", lines[2].2);
}
