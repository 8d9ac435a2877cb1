//! A host just large enough to describe and tie a class by hand: f64 slots that record what comes through.
//!
//! Invariant: cells and slots live in boxes, so their addresses stay whatever a test does to the lists.
#![allow(clippy::vec_box)] // See the invariant.

use core::ffi::c_void;
use std::sync::Arc;
use std::sync::atomic::{AtomicI32, AtomicU32, Ordering};
use trocar_plugin_api::abi::*;
use trocar_plugin_api::manifest::Description;
use trocar_sdk::__private::{Export, Shared, render_description};
use trocar_sdk::{Class, Payload, Text, from_bytes};

/// Content of one slot.
#[derive(Default)]
pub(crate) struct Cell {
    pub(crate) value: Option<f64>,
    pub(crate) written: Vec<f64>,
}

/// Requests of the component to the host, and what it may ask for.
#[derive(Default)]
pub(crate) struct Asked {
    pub(crate) ports_changed: u32,
    pub(crate) services: Vec<(u64, String)>,
    /// Threads of `trocar.parallel/1`; without any, the host has no such extension.
    pub(crate) threads: u32,
    /// Number of times it asked to keep what it was given.
    pub(crate) kept: Arc<AtomicU32>,
}

pub(crate) struct LittleHost<C: Class> {
    this: *mut c_void,
    table: Box<HostTable>,
    pub(crate) description: Description,
    pub(crate) inputs: Vec<Box<Cell>>,
    pub(crate) outputs: Vec<Box<Cell>>,
    pub(crate) functions: Vec<Box<Cell>>,
    pub(crate) events: Vec<Box<Cell>>,
    slots: Slots,
    pub(crate) asked: Box<Asked>,
    class: core::marker::PhantomData<C>,
}

#[derive(Default)]
struct Slots {
    inputs: Vec<Box<InSlot>>,
    outputs: Vec<Box<OutSlot>>,
    functions: Vec<Box<FnSlot>>,
    events: Vec<Box<EventSlot>>,
}

type Done<T = ()> = Result<T, (Status, String)>;

fn entry(f: impl FnOnce(*mut ErrBuf) -> Status) -> Done {
    let mut text = [0u8; 512];
    let mut err = ErrBuf { ptr: text.as_mut_ptr(), cap: text.len(), len: 0 };
    match f(&mut err) {
        STATUS_OK => Ok(()),
        status => Err((status, String::from_utf8_lossy(&text[..err.len]).into_owned())),
    }
}

fn bytes(text: &str) -> Bytes {
    Bytes { ptr: text.as_ptr(), len: text.len() }
}

#[allow(dead_code)] // Not each test file uses everything.
impl<C: Class> LittleHost<C> {
    pub(crate) fn new() -> Box<Self> {
        let length = render_description::<0>(C::DESC).1;
        let text = match C::DESCRIPTION {
            "" => r#"{"class": {"name": "plain"}}"#,
            text => text,
        };
        assert!(C::DESCRIPTION.is_empty() || text.len() == length);
        let mut host = Box::new(LittleHost {
            this: core::ptr::null_mut(),
            table: host_table(),
            description: serde_json::from_str(text).unwrap(),
            inputs: Vec::new(),
            outputs: Vec::new(),
            functions: Vec::new(),
            events: Vec::new(),
            slots: Slots::default(),
            asked: Box::default(),
            class: core::marker::PhantomData,
        });
        host.table.ctx = (&raw mut *host.asked).cast();
        // SAFETY: the table lives as long as the instance.
        host.this =
            unsafe { (Export::<C>::TABLE.create.unwrap())(&*host.table, bytes("it"), core::ptr::null_mut()) };
        host.make_cells();
        host.bind().unwrap();
        host
    }

    /// The instance, for a test that calls the table itself.
    pub(crate) fn this(&self) -> *mut c_void {
        self.this
    }

    fn make_cells(&mut self) {
        fn cells(n: usize) -> Vec<Box<Cell>> {
            (0..n).map(|_| Box::default()).collect()
        }
        let class = &self.description.class;
        self.inputs = cells(class.inputs.len());
        self.outputs = cells(class.outputs.len());
        self.functions = cells(class.required.iter().map(|r| r.functions.len()).sum());
        self.events = cells(class.provided.iter().map(|p| p.events.len()).sum());
    }

    pub(crate) fn bind(&mut self) -> Done {
        fn ctx(cell: &mut Box<Cell>) -> *mut c_void {
            (&raw mut **cell).cast()
        }
        fn pointers<S>(slots: &[Box<S>]) -> Vec<*const S> {
            slots.iter().map(|s| &raw const **s).collect()
        }
        let slots = Slots {
            inputs: self.inputs.iter_mut().map(|c| Box::new(in_slot(ctx(c)))).collect(),
            outputs: self.outputs.iter_mut().map(|c| Box::new(out_slot(ctx(c)))).collect(),
            functions: self.functions.iter_mut().map(|c| Box::new(fn_slot(ctx(c)))).collect(),
            events: self.events.iter_mut().map(|c| Box::new(event_slot(ctx(c)))).collect(),
        };
        let (inputs, outputs) = (pointers(&slots.inputs), pointers(&slots.outputs));
        let (functions, events) = (pointers(&slots.functions), pointers(&slots.events));
        let ports = Ports {
            struct_size: size_of::<Ports>() as u32,
            output_count: outputs.len() as u32,
            input_count: inputs.len() as u32,
            function_count: functions.len() as u32,
            event_count: events.len() as u32,
            reserved: 0,
            outputs: outputs.as_ptr(),
            inputs: inputs.as_ptr(),
            functions: functions.as_ptr(),
            events: events.as_ptr(),
        };
        // SAFETY: the slots live until the next bind or the end of the instance.
        let done = entry(|err| unsafe { (Export::<C>::TABLE.bind.unwrap())(self.this, &ports, err) });
        if done.is_ok() {
            self.slots = slots;
        }
        done
    }

    pub(crate) fn describe_and_bind(&mut self) {
        self.description = self.describe();
        self.make_cells();
        self.bind().unwrap();
    }

    pub(crate) fn describe(&mut self) -> Description {
        unsafe extern "C" fn write(ctx: *mut c_void, bytes: Bytes) {
            // SAFETY: `ctx` is the vector below.
            unsafe {
                (*ctx.cast::<Vec<u8>>()).extend_from_slice(core::slice::from_raw_parts(bytes.ptr, bytes.len));
            }
        }
        let mut text: Vec<u8> = Vec::new();
        let sink = Sink { ctx: (&raw mut text).cast(), write };
        // SAFETY: a live instance, a sink that lives through the call.
        assert_eq!(unsafe { (Export::<C>::TABLE.describe.unwrap())(self.this, &sink) }, STATUS_OK);
        serde_json::from_slice(&text).unwrap()
    }

    pub(crate) fn configure(&mut self, json: &str) -> Done {
        // SAFETY: a live instance.
        entry(|err| unsafe { (Export::<C>::TABLE.configure.unwrap())(self.this, bytes(json), err) })
    }

    pub(crate) fn start(&mut self) -> Done {
        // SAFETY: a live instance.
        entry(|err| unsafe { (Export::<C>::TABLE.start.unwrap())(self.this, err) })
    }

    pub(crate) fn step(&mut self) -> Done {
        let tick = Tick { struct_size: size_of::<Tick>() as u32, now_ns: 1, ..Tick::default() };
        // SAFETY: a live instance.
        entry(|err| unsafe { (Export::<C>::TABLE.step.unwrap())(self.this, &tick, err) })
    }

    /// A command that takes and gives an f64, or neither.
    pub(crate) fn command(&mut self, id: u32, arg: f64) -> Done<f64> {
        let mut ret = 0.0f64;
        let (arg, out) = ((&raw const arg).cast(), (&raw mut ret).cast());
        // SAFETY: a live instance; argument and result are f64 or unused.
        entry(|err| unsafe { (Export::<C>::TABLE.command.unwrap())(self.this, id, arg, out, err) })?;
        Ok(ret)
    }

    /// The command with id 0, which takes a text.
    pub(crate) fn rename(&mut self, to: &str) -> Done {
        let (text, ret) = (Text::<16>::new(to), core::ptr::null_mut());
        let arg = (&raw const text).cast();
        // SAFETY: a live instance; the argument is the described text.
        entry(|err| unsafe { (Export::<C>::TABLE.command.unwrap())(self.this, 0, arg, ret, err) })
    }

    pub(crate) fn read(&mut self, id: u32) -> Done<f64> {
        let (row, mut ret) = (self.state(), 0.0f64);
        let (row, out) = ((&raw const row).cast(), (&raw mut ret).cast());
        let read = Export::<C>::TABLE.read.unwrap();
        // SAFETY: the row is the class's; the result is an f64.
        entry(|err| unsafe { read(row, id, core::ptr::null(), out, err) })?;
        Ok(ret)
    }

    pub(crate) fn on_event(&mut self, id: u32, payload: u32) -> Done {
        let payload = (&raw const payload).cast();
        // SAFETY: a live instance; the payload is a u32 or unused.
        entry(|err| unsafe { (Export::<C>::TABLE.on_event.unwrap())(self.this, id, payload, err) })
    }

    pub(crate) fn reply(&mut self, token: u64, reply: &str) -> Status {
        // SAFETY: a live instance; the text lives through the call.
        unsafe { (Export::<C>::TABLE.on_service.unwrap())(self.this, token, bytes(reply)) }
    }

    pub(crate) fn state(&self) -> C::State {
        let mut row = vec![0u8; size_of::<C::State>()];
        if let Some(copy) = Export::<C>::TABLE.state_copy {
            // SAFETY: a live instance; the row has the state's size.
            unsafe { copy(self.this, row.as_mut_ptr().cast(), row.len()) };
        }
        from_bytes(&row).unwrap_or_else(C::State::zeroed)
    }
}

impl<C: Class> Drop for LittleHost<C> {
    fn drop(&mut self) {
        // SAFETY: the instance's last use.
        unsafe { (Export::<C>::TABLE.destroy.unwrap())(self.this) };
    }
}

/// # Safety
/// `ctx` is a cell's address.
unsafe fn cell<'a>(ctx: *mut c_void) -> &'a mut Cell {
    // SAFETY: by the caller's promise; tests run on one thread.
    unsafe { &mut *ctx.cast::<Cell>() }
}

unsafe extern "C" fn type_of(_: *mut c_void, _: *const Sink) -> Status {
    STATUS_UNSUPPORTED
}

fn in_slot(ctx: *mut c_void) -> InSlot {
    unsafe extern "C" fn latest(ctx: *mut c_void, view: *mut SampleView) -> i32 {
        // SAFETY: the slot's own cell, and a writable view.
        let (cell, view) = unsafe { (cell(ctx), &mut *view) };
        let Some(value) = &cell.value else { return IN_EMPTY };
        view.header = (value as *const f64).cast();
        view.flags = SAMPLE_FRESH;
        IN_SAMPLE
    }
    unsafe extern "C" fn release(_: *mut c_void) {}
    unsafe extern "C" fn writable(_: *mut c_void, _: *mut SampleView) -> *mut u8 {
        core::ptr::null_mut()
    }
    unsafe extern "C" fn header_len(_: *mut c_void) -> u64 {
        8
    }
    unsafe extern "C" fn hold(_: *mut c_void, _: *mut Held) -> i32 {
        IN_EMPTY
    }
    let struct_size = size_of::<InSlot>() as u32;
    InSlot { struct_size, flags: 0, ctx, latest, next: latest, release, writable, type_of, header_len, hold }
}

fn out_slot(ctx: *mut c_void) -> OutSlot {
    unsafe extern "C" fn write(ctx: *mut c_void, value: *const c_void, _: u64) -> Outcome {
        // SAFETY: the slot's own cell; outputs of these tests begin with an f64.
        unsafe { cell(ctx).written.push(value.cast::<f64>().read_unaligned()) };
        EXECUTED
    }
    unsafe extern "C" fn loan(_: *mut c_void, _: *mut Loan) -> Outcome {
        EXHAUSTED
    }
    unsafe extern "C" fn commit(_: *mut c_void, _: *mut Loan, _: u64, _: u64) -> Outcome {
        UNBOUND
    }
    unsafe extern "C" fn cancel(_: *mut c_void, _: *mut Loan) {}
    unsafe extern "C" fn forward(_: *mut c_void, _: *const SampleView, _: u64) -> Outcome {
        UNBOUND
    }
    unsafe extern "C" fn reserve(_: *mut c_void, _: u64, _: u32) -> Outcome {
        EXECUTED
    }
    unsafe extern "C" fn write_bytes(ctx: *mut c_void, value: Bytes, stamp: u64) -> Outcome {
        // SAFETY: the slot's own cell; the value has the size it says.
        if value.len == 8 { unsafe { write(ctx, value.ptr.cast(), stamp) } } else { INVALID_ARGUMENT }
    }
    let struct_size = size_of::<OutSlot>() as u32;
    OutSlot {
        struct_size,
        flags: 0,
        ctx,
        write,
        loan,
        commit,
        cancel,
        forward,
        reserve,
        type_of,
        write_bytes,
    }
}

/// Answers with twice the argument.
fn fn_slot(ctx: *mut c_void) -> FnSlot {
    unsafe extern "C" fn call(
        ctx: *mut c_void,
        arg: *const c_void,
        ret: *mut c_void,
        _: *mut CallOpts,
    ) -> Outcome {
        // SAFETY: the slot's own cell; arguments are f64 where a result is asked for.
        unsafe {
            let arg = if ret.is_null() { 0.0 } else { arg.cast::<f64>().read_unaligned() };
            cell(ctx).written.push(arg);
            if !ret.is_null() {
                ret.cast::<f64>().write_unaligned(2.0 * arg);
            }
        }
        EXECUTED
    }
    unsafe extern "C" fn call_bytes(
        ctx: *mut c_void,
        arg: Bytes,
        ret: *mut c_void,
        ret_len: u64,
        opts: *mut CallOpts,
    ) -> Outcome {
        if (arg.len, ret_len) != (8, 8) {
            return INVALID_ARGUMENT;
        }
        // SAFETY: the slot's own cell; argument and result are f64.
        unsafe { call(ctx, arg.ptr.cast(), ret, opts) }
    }
    FnSlot { struct_size: size_of::<FnSlot>() as u32, flags: 0, ctx, call, type_of, call_bytes }
}

fn event_slot(ctx: *mut c_void) -> EventSlot {
    unsafe extern "C" fn emit(ctx: *mut c_void, payload: *const c_void) -> Outcome {
        // SAFETY: the slot's own cell; events of these tests carry an f64.
        unsafe { cell(ctx).written.push(payload.cast::<f64>().read_unaligned()) };
        EXECUTED
    }
    EventSlot { struct_size: size_of::<EventSlot>() as u32, flags: 0, ctx, emit }
}

fn host_table() -> Box<HostTable> {
    unsafe extern "C" fn now_ns(_: *mut c_void) -> u64 {
        1
    }
    unsafe extern "C" fn log(_: *mut c_void, _: u32, _: Bytes, _: Bytes) {}
    unsafe extern "C" fn service(ctx: *mut c_void, token: u64, request: Bytes) -> Outcome {
        // SAFETY: the context is the host's record; the text is readable during the call.
        unsafe {
            let text = core::slice::from_raw_parts(request.ptr, request.len);
            (*ctx.cast::<Asked>()).services.push((token, String::from_utf8_lossy(text).into_owned()));
        }
        QUEUED
    }
    unsafe extern "C" fn enter(_: *mut c_void) -> Outcome {
        EXECUTED
    }
    unsafe extern "C" fn leave(_: *mut c_void) {}
    unsafe extern "C" fn extension(ctx: *mut c_void, id: Bytes) -> *const c_void {
        // SAFETY: the context is the host's record; the text is readable during the call.
        let (threads, id) =
            unsafe { ((*ctx.cast::<Asked>()).threads, core::slice::from_raw_parts(id.ptr, id.len)) };
        match threads {
            _ if id == KEEP.as_bytes() => (&raw const KEEPER).cast(),
            1.. if id == PARALLEL.as_bytes() => (&raw const POOL.0).cast(),
            _ => core::ptr::null(),
        }
    }
    unsafe extern "C" fn ports_changed(ctx: *mut c_void) -> Outcome {
        // SAFETY: the context is the host's record.
        unsafe { (*ctx.cast::<Asked>()).ports_changed += 1 };
        QUEUED
    }
    Box::new(HostTable {
        struct_size: size_of::<HostTable>() as u32,
        flags: 0,
        abi_major: ABI_MAJOR,
        abi_minor: ABI_MINOR,
        ctx: core::ptr::null_mut(),
        now_ns,
        log,
        service,
        callback_enter: enter,
        callback_leave: leave,
        extension,
        ports_changed,
    })
}

static KEEPER: Keep = Keep { struct_size: size_of::<Keep>() as u32, flags: 0, keep };

unsafe extern "C" fn keep(ctx: *mut c_void) {
    // SAFETY: the context is the host's record.
    unsafe { (*ctx.cast::<Asked>()).kept.fetch_add(1, Ordering::SeqCst) };
}

/// Three threads that take slices in turn; the caller waits.
static POOL: Shared<Parallel> = Shared(Parallel {
    struct_size: size_of::<Parallel>() as u32,
    flags: 0,
    ctx: core::ptr::null_mut(),
    threads: pool_threads,
    run: pool_run,
});

unsafe extern "C" fn pool_threads(_: *mut c_void) -> u32 {
    3
}

unsafe extern "C" fn pool_run(_: *mut c_void, slices: u32, body: *const SliceBody) -> Status {
    struct Body(SliceBody);
    // SAFETY: the contract of `SliceBody`: it is called from several threads at once.
    unsafe impl Sync for Body {}
    impl Body {
        fn run(&self, slice: u32) -> Status {
            // SAFETY: each slice once, while the caller waits.
            unsafe { (self.0.run)(self.0.data, slice) }
        }
    }
    // SAFETY: the caller lends the body for the call.
    let body = unsafe { Body(SliceBody { data: (*body).data, run: (*body).run }) };
    let next = AtomicU32::new(0);
    let failed = AtomicI32::new(STATUS_OK);
    std::thread::scope(|scope| {
        for _ in 0..3 {
            scope.spawn(|| {
                loop {
                    let slice = next.fetch_add(1, Ordering::Relaxed);
                    if slice >= slices {
                        return;
                    }
                    let status = body.run(slice);
                    if status < STATUS_OK {
                        failed.store(status, Ordering::Relaxed);
                    }
                }
            });
        }
    });
    failed.into_inner()
}
