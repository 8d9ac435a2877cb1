//! A step, a write, a send, an emit and a state copy through the C table allocate nothing.
//!
//! Invariant: only this thread is counted; the one that runs tests allocates when it likes.
#![allow(clippy::unwrap_used)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicUsize, Ordering};
use trocar_plugin_api::abi::{Bytes, ErrBuf, HostTable, STATUS_OK, Tick as AbiTick};
use trocar_sdk::prelude::*;

struct Counting;
static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

thread_local! {
    static COUNTED: Cell<bool> = const { Cell::new(false) };
}

// SAFETY: hands everything to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(usize::from(COUNTED.get()), Ordering::Relaxed);
        // SAFETY: the caller's contract is the system allocator's.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, ptr: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(ptr, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[derive(Component)]
#[component(rate_hz = 1000)]
struct Busy {
    #[input]
    x: In<f64>,
    #[output]
    y: Out<f64>,
    #[required]
    hold: Function<f64>,
    #[event("ctl")]
    event: Event<f64>,
    #[state]
    sum: f64,
}

#[provides("ctl")]
impl Busy {
    #[command]
    fn add(&mut self, value: f64) -> f64 {
        self.sum += value;
        self.sum
    }
}

impl Component for Busy {
    fn step(&mut self, tick: &Tick) -> Result {
        self.sum += self.x.latest().unwrap_or(tick.period_s());
        self.y.write(&self.sum);
        self.hold.send(self.sum);
        self.event.emit(self.sum);
        Ok(())
    }
}

mod host {
    use std::ffi::c_void;
    use trocar_plugin_api::abi::{Bytes, EXECUTED, Outcome};

    pub(crate) unsafe extern "C" fn now_ns(_: *mut c_void) -> u64 {
        1
    }
    pub(crate) unsafe extern "C" fn log(_: *mut c_void, _: u32, _: Bytes, _: Bytes) {}
    pub(crate) unsafe extern "C" fn service(_: *mut c_void, _: u64, _: Bytes) -> Outcome {
        EXECUTED
    }
    pub(crate) unsafe extern "C" fn enter(_: *mut c_void) -> Outcome {
        EXECUTED
    }
    pub(crate) unsafe extern "C" fn leave(_: *mut c_void) {}
    pub(crate) unsafe extern "C" fn extension(_: *mut c_void, _: Bytes) -> *const c_void {
        std::ptr::null()
    }
}

#[test]
fn the_happy_path_allocates_nothing() {
    let table = trocar_sdk::__private::Export::<Busy>::TABLE;
    let host = HostTable {
        struct_size: size_of::<HostTable>() as u32,
        flags: 0,
        abi_major: 1,
        abi_minor: 0,
        ctx: std::ptr::null_mut(),
        now_ns: host::now_ns,
        log: host::log,
        service: host::service,
        callback_enter: host::enter,
        callback_leave: host::leave,
        extension: host::extension,
        ports_changed: host::enter,
    };
    let mut text = [0u8; 64];
    let mut err = ErrBuf { ptr: text.as_mut_ptr(), cap: text.len(), len: 0 };
    let name = Bytes { ptr: "busy".as_ptr(), len: 4 };
    let mut tick =
        AbiTick { struct_size: size_of::<AbiTick>() as u32, period_ns: 1_000_000, ..Default::default() };
    let (arg, mut ret, mut row) = (2.0f64, 0.0f64, 0.0f64);
    // SAFETY: the entries are called as a host does: one thread, a live instance, values of the described
    // types.
    unsafe {
        let this = table.create.unwrap()(&host, name, &mut err);
        assert!(!this.is_null());
        let (step, command, copy) = (table.step.unwrap(), table.command.unwrap(), table.state_copy.unwrap());
        COUNTED.set(true);
        drop(std::hint::black_box(Box::new(0u8)));
        let before = ALLOCATIONS.load(Ordering::Relaxed);
        assert_eq!(before, 1, "allocations of this thread are counted");
        for cycle in 0..1000 {
            tick.cycle = cycle;
            tick.now_ns = cycle + 1;
            assert_eq!(step(this, &tick, &mut err), STATUS_OK);
            let status = command(this, 0, (&raw const arg).cast(), (&raw mut ret).cast(), &mut err);
            assert_eq!(status, STATUS_OK);
            copy(this, (&raw mut row).cast(), size_of::<f64>());
        }
        let made = ALLOCATIONS.load(Ordering::Relaxed) - before;
        assert_eq!(made, 0, "1000 cycles allocated {made} times");
        assert_eq!(row, ret);
        table.destroy.unwrap()(this);
    }
}
