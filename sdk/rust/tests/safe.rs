//! A class that is safe from any thread: its handle makes it safe, beside an entry that hangs, and the
//! component is left alone.
#![allow(clippy::unwrap_used)]

use core::ffi::c_void;
use std::ptr::null_mut;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Barrier, LazyLock};
use trocar_plugin_api::abi::{self, Bytes, ErrBuf, STATUS_FAILED, STATUS_OK, STATUS_PANICKED, Status};
use trocar_sdk::__private::Export;
use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

/// Meeting point of the step that hangs and the test.
struct Outside {
    /// The step is inside, and may go on.
    inside: Barrier,
    goes_on: Barrier,
}

static OUTSIDE: LazyLock<Outside> =
    LazyLock::new(|| Outside { inside: Barrier::new(2), goes_on: Barrier::new(2) });

#[derive(Default)]
struct Brake {
    closed: AtomicU64,
    breaks: AtomicBool,
    fails: AtomicBool,
}

impl MakeSafe for Brake {
    fn make_safe(&self) -> Result {
        self.closed.fetch_add(1, Ordering::SeqCst);
        assert!(!self.breaks.load(Ordering::SeqCst), "the brake is off its hinges");
        if self.fails.load(Ordering::SeqCst) { Err("the brake does not close".into()) } else { Ok(()) }
    }
}

#[derive(Component)]
#[component(rate_hz = 1000, safety = "actuator", safe_from_any_thread, provides("ctl"))]
struct Axis {
    #[state]
    braked: u64,
    /// As many words as a write from elsewhere would be seen in.
    work: [u64; 32],
    brake: Arc<Brake>,
    #[config]
    cfg: Cfg,
}

#[derive(Config)]
struct Cfg {
    #[config(default = false)]
    hangs: bool,
    #[config(default = false)]
    breaks: bool,
    #[config(default = false)]
    fails: bool,
}

#[provides("ctl")]
impl Axis {
    #[command]
    fn turn(&mut self) {
        self.work = [0; 32];
    }
}

impl SafeFromAnyThread for Axis {
    fn safe_handle(&self) -> Arc<dyn MakeSafe> {
        self.brake.clone()
    }
}

impl Component for Axis {
    fn configure(&mut self) -> Result {
        self.brake.breaks.store(self.cfg.breaks, Ordering::SeqCst);
        self.brake.fails.store(self.cfg.fails, Ordering::SeqCst);
        Ok(())
    }
    fn step(&mut self, _: &Tick) -> Result {
        self.work = [7; 32];
        if self.cfg.hangs {
            OUTSIDE.inside.wait();
            OUTSIDE.goes_on.wait();
        }
        assert_eq!(self.work, [7; 32]);
        self.braked = self.brake.closed.load(Ordering::SeqCst);
        Ok(())
    }
    fn make_safe(&mut self) -> Result {
        panic!("this is the way of a component that only one thread at a time may touch")
    }
}

/// An instance behind its C table.
#[derive(Clone, Copy)]
struct Raw(*mut c_void);

// SAFETY: the table's entries may come from any thread; the tests below serialise them as a host does.
unsafe impl Send for Raw {}

impl Raw {
    fn step(self) -> Status {
        let tick = abi_tick();
        // SAFETY: a live instance, and no other serialised entry is inside.
        unsafe { (Export::<Axis>::TABLE.step.unwrap())(self.0, &tick, null_mut()) }
    }
    fn make_safe(self) -> (Status, String) {
        let mut room = [0u8; 256];
        let mut err = ErrBuf { ptr: room.as_mut_ptr(), cap: room.len(), len: 0 };
        // SAFETY: a live instance of a class that is safe from any thread.
        let status = unsafe { (Export::<Axis>::TABLE.make_safe.unwrap())(self.0, &mut err) };
        (status, String::from_utf8_lossy(&room[..err.len]).into_owned())
    }
    fn braked(self) -> u64 {
        let mut row = 0u64;
        // SAFETY: a live instance with nobody inside; the row is one u64.
        unsafe { (Export::<Axis>::TABLE.state_copy.unwrap())(self.0, (&raw mut row).cast(), 8) };
        row
    }
}

fn abi_tick() -> abi::Tick {
    abi::Tick {
        struct_size: size_of::<abi::Tick>() as u32,
        flags: 0,
        cycle: 0,
        now_ns: 1,
        deadline_ns: 1,
        period_ns: 1_000_000,
        elapsed_ns: 1_000_000,
    }
}

#[path = "little_host/mod.rs"]
mod little_host;

/// An axis, configured.
fn axis(config: &str) -> (Box<little_host::LittleHost<Axis>>, Raw) {
    let host = little_host::LittleHost::<Axis>::new();
    let this = Raw(host.this());
    let json = Bytes { ptr: config.as_ptr(), len: config.len() };
    // SAFETY: a live instance, entered by this thread alone; the text lives through the call.
    let status = unsafe { (Export::<Axis>::TABLE.configure.unwrap())(this.0, json, null_mut()) };
    assert_eq!(status, STATUS_OK);
    (host, this)
}

#[test]
fn a_device_is_made_safe_again_and_again_while_a_step_of_it_hangs() {
    let (_host, axis) = axis(r#"{"hangs": true}"#);
    let stepping = std::thread::spawn(move || axis.step());
    OUTSIDE.inside.wait();
    let others: Vec<_> = (0..4)
        .map(|_| std::thread::spawn(move || (0..100).all(|_| axis.make_safe().0 == STATUS_OK)))
        .collect();
    assert!(others.into_iter().all(|t| t.join().unwrap()), "nobody waited for the step");
    OUTSIDE.goes_on.wait();
    assert_eq!(stepping.join().unwrap(), STATUS_OK, "and it found its own fields as it left them");
    assert_eq!(axis.braked(), 400);
}

#[test]
fn what_a_handle_says_or_breaks_stays_a_status_and_a_sentence() {
    let (_fails, axis_that_fails) = axis(r#"{"fails": true}"#);
    assert_eq!(axis_that_fails.make_safe(), (STATUS_FAILED, "the brake does not close".to_owned()));
    let (_breaks, axis_that_breaks) = axis(r#"{"breaks": true}"#);
    let (status, why) = axis_that_breaks.make_safe();
    assert_eq!(status, STATUS_PANICKED);
    assert!(why.ends_with("the brake is off its hinges"), "{why}");
}

#[test]
fn every_way_out_goes_through_the_handle() {
    let mut bench = Bench::<Axis>::new("{}");
    bench.stop().unwrap();
    bench.start().unwrap();
    bench.step(1);
    assert_eq!(bench.state().braked, 1, "by Stop");
    bench.make_safe().unwrap();
    bench.step(1);
    assert_eq!(bench.state().braked, 2, "when asked for");
    bench.reset().unwrap();
    bench.start().unwrap();
    bench.step(1);
    assert_eq!(bench.state().braked, 0, "another instance, another brake");
}
