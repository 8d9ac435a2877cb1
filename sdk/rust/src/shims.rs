//! The C table of a class: every entry guarded, every pointer turned into a typed reference in one place.
//!
//! Invariant: `this` is always a `Box<Instance<C>>` made by `create`; the LCM serialises the calls on it,
//! except `make_safe` of a class with `safe_from_any_thread`, which may run beside any other. So no entry
//! borrows the whole `Instance`, and that `make_safe` touches only its handle.

use crate::binder::Binder;
use crate::call::Call;
use crate::class::Class;
use crate::component::Tick;
use crate::config::JsonObject;
use crate::guard::{Chain, guard, refuse, settle};
use crate::host::Host;
use crate::lease::Tie;
use crate::lists::Layout;
use crate::payload::Payload;
use crate::safe::MakeSafe;
use core::ffi::c_void;
use core::marker::PhantomData;
use serde_json::Value as Json;
use std::sync::Arc;
use trocar_plugin_api::abi::{
    self, Bytes, ClassTable, ErrBuf, HostTable, Ports, STATUS_INVALID, STATUS_OK, Sink, Status,
};

struct Instance<C> {
    /// Reached by one entry at a time, through [`component`].
    component: C,
    /// Words that the host was told and slots that it gave; reached by one entry at a time, through [`own`].
    own: Own,
    /// Never changes after `create`.
    beside: Beside,
}

/// The meaning of ids and slots, kept where the author's code does not reach it.
struct Own {
    /// The lists of the last description, and those since the last `bind`.
    described: Layout,
    bound: Layout,
    tie: Tie,
}

/// Part that may be read while an entry is inside the component.
struct Beside {
    host: Host,
    /// Handle of a class with `safe_from_any_thread`.
    safe: Option<Arc<dyn MakeSafe>>,
}

/// Holds the table of `C`.
pub struct Export<C>(PhantomData<C>);

impl<C: Class> Export<C> {
    /// The entries of `C` behind the C ABI.
    pub const TABLE: &'static ClassTable = &ClassTable {
        struct_size: size_of::<ClassTable>() as u32,
        flags: 0,
        name: Bytes { ptr: C::DESC.name.as_ptr(), len: C::DESC.name.len() },
        create: Some(create::<C>),
        destroy: Some(destroy::<C>),
        configure: Some(configure::<C>),
        describe: if C::DESCRIPTION.is_empty() { None } else { Some(describe::<C>) },
        bind: Some(bind::<C>),
        start: Some(start::<C>),
        stop: Some(stop::<C>),
        resume: Some(resume::<C>),
        make_safe: Some(make_safe::<C>),
        step: Some(step::<C>),
        command: Some(command::<C>),
        read: Some(read::<C>),
        on_event: Some(on_event::<C>),
        on_service: Some(on_service::<C>),
        state_copy: if C::DESC.state.is_some() { Some(state_copy::<C>) } else { None },
        snapshot: Some(snapshot::<C>),
        restore: Some(restore::<C>),
        extension: None,
    };
}

/// # Safety
/// `bytes` is readable for `'a`.
unsafe fn slice<'a>(bytes: Bytes) -> &'a [u8] {
    if bytes.ptr.is_null() {
        return &[];
    }
    // SAFETY: non-null bytes are readable, by the caller's promise.
    unsafe { core::slice::from_raw_parts(bytes.ptr, bytes.len) }
}

/// # Safety
/// `this` comes from `create::<C>`, and no other entry has its component during `'a`.
#[inline]
unsafe fn component<'a, C>(this: *mut c_void) -> &'a mut C {
    // SAFETY: by the caller's promise a live instance whose component nobody else uses; the rest of it is not
    // borrowed.
    unsafe { &mut (*this.cast::<Instance<C>>()).component }
}

/// # Safety
/// As [`component`].
#[inline]
unsafe fn own<'a, C>(this: *mut c_void) -> &'a mut Own {
    // SAFETY: by the caller's promise a live instance; the component beside it is not borrowed.
    unsafe { &mut (*this.cast::<Instance<C>>()).own }
}

/// # Safety
/// `this` comes from `create::<C>` and lives during `'a`; other entries may be inside its component.
#[inline]
unsafe fn beside<'a, C>(this: *mut c_void) -> &'a Beside {
    // SAFETY: by the caller's promise a live instance; this part of it is never written after `create`, and
    // the component is not borrowed.
    unsafe { &(*this.cast::<Instance<C>>()).beside }
}

unsafe extern "C" fn create<C: Class>(
    host: *const HostTable,
    instance_name: Bytes,
    err: *mut ErrBuf,
) -> *mut c_void {
    let mut made: *mut c_void = core::ptr::null_mut();
    let mut tie = None;
    guard(err, || {
        if host.is_null() {
            return refuse(err, STATUS_INVALID, &"create was called without a host table");
        }
        // SAFETY: the name is readable during the call; the table until destroy, and until the end of the
        // process for handles that `Tie::end` finds still there.
        let host = unsafe { Host::new(host, &String::from_utf8_lossy(slice(instance_name))) };
        tie = Some(Tie::new(&host));
        let component = C::create(host.clone());
        let safe = component.safe_handle();
        if let Some(tie) = tie.take() {
            let own = Own { described: Layout::default(), bound: Layout::default(), tie };
            made = Box::into_raw(Box::new(Instance { component, own, beside: Beside { host, safe } })).cast();
        }
        STATUS_OK
    });
    if made.is_null()
        && let Some(tie) = tie
    {
        tie.end();
    }
    made
}

unsafe extern "C" fn destroy<C: Class>(this: *mut c_void) {
    guard(core::ptr::null_mut(), || {
        if !this.is_null() {
            // SAFETY: `this` was made by `create::<C>` and this is its last use.
            let Instance { component, own, beside } = *unsafe { Box::from_raw(this.cast::<Instance<C>>()) };
            // Dropped in the opposite order, also when the component's Drop panics.
            let _last = Last(Some(own.tie));
            let _all = (component, beside);
        }
        STATUS_OK
    });
}

/// Looks, once all of an instance is gone, whether its handles are.
struct Last(Option<Tie>);

impl Drop for Last {
    fn drop(&mut self) {
        if let Some(tie) = self.0.take() {
            tie.end();
        }
    }
}

unsafe extern "C" fn configure<C: Class>(this: *mut c_void, json: Bytes, err: *mut ErrBuf) -> Status {
    guard(err, || {
        // SAFETY: the table's contract: serialised calls on a live instance, readable bytes.
        let (component, json) = unsafe { (component::<C>(this), slice(json)) };
        let parsed: Result<JsonObject, _> = match json {
            [] => Ok(JsonObject::new()),
            json => serde_json::from_slice::<Json>(json).and_then(serde_json::from_value),
        };
        match parsed {
            Err(e) => {
                refuse(err, STATUS_INVALID, &format_args!("the configuration is not a JSON object: {e}"))
            }
            Ok(object) => match component.apply(&object) {
                Ok(()) => STATUS_OK,
                Err(e) => refuse(err, STATUS_INVALID, &Chain(&*e)),
            },
        }
    })
}

unsafe extern "C" fn describe<C: Class>(this: *mut c_void, sink: *const Sink) -> Status {
    guard(core::ptr::null_mut(), || {
        // SAFETY: a live instance and a sink that is valid for the call.
        let (component, own, beside, sink) =
            unsafe { (component::<C>(this), own::<C>(this), beside::<C>(this), &*sink) };
        let text = match crate::describe::build(component) {
            Ok(json) => json.to_string(),
            Err(e) => {
                log::error!("{}: {e}", beside.host.instance_name());
                return STATUS_INVALID;
            }
        };
        own.described = Layout::wanted(&component.lists());
        // SAFETY: the sink's own context; the bytes live through the call.
        unsafe { (sink.write)(sink.ctx, Bytes { ptr: text.as_ptr(), len: text.len() }) };
        STATUS_OK
    })
}

unsafe extern "C" fn bind<C: Class>(this: *mut c_void, ports: *const Ports, err: *mut ErrBuf) -> Status {
    guard(err, || {
        // SAFETY: a live instance; the slot tables are valid until the next bind or destroy.
        let (component, own, ports) = unsafe { (component::<C>(this), own::<C>(this), &*ports) };
        let given = [ports.input_count, ports.output_count, ports.function_count, ports.event_count];
        let wanted = slot_counts::<C>(&own.described);
        if given != wanted {
            return refuse(
                err,
                STATUS_INVALID,
                &format_args!(
                    "the host binds {given:?} inputs, outputs, functions and events, class {} has {wanted:?}",
                    C::DESC.name
                ),
            );
        }
        let _settled = own.tie.renew();
        own.bound.clone_from(&own.described);
        // SAFETY: counts agree; the host made the slots from the manifest or the last description. They stay
        // until the next bind or destroy, and longer where one of these two finds that somebody holds them.
        component.bind(&unsafe { Binder::new(ports, &own.tie, &own.bound) });
        if !C::DESCRIPTION.is_empty() {
            component.ports_changed();
        }
        STATUS_OK
    })
}

/// Inputs, outputs, functions, events.
fn slot_counts<C: Class>(lists: &Layout) -> [u32; 4] {
    let functions: usize = C::DESC.required.iter().map(|r| r.functions.len()).sum();
    let events: usize = C::DESC.provided.iter().map(|p| p.events.len()).sum();
    let mut counts = [C::DESC.inputs.len(), C::DESC.outputs.len(), functions, events];
    let many = &C::DESC.many;
    counts[0] += lists.inputs.iter().map(Vec::len).sum::<usize>();
    counts[1] += lists.outputs.iter().map(Vec::len).sum::<usize>();
    counts[2] +=
        lists.required.iter().zip(many.required).map(|(l, i)| l.len() * i.functions.len()).sum::<usize>();
    counts[3] +=
        lists.provided.iter().zip(many.provided).map(|(l, i)| l.len() * i.events.len()).sum::<usize>();
    counts.map(|n| n as u32)
}

macro_rules! plain_entries {
    ($($name:ident),*) => {$(
        unsafe extern "C" fn $name<C: Class>(this: *mut c_void, err: *mut ErrBuf) -> Status {
            // SAFETY: the table's contract: serialised calls on a live instance.
            guard(err, || settle(err, unsafe { component::<C>(this) }.$name()))
        }
    )*};
}
plain_entries!(start, stop, resume);

unsafe extern "C" fn make_safe<C: Class>(this: *mut c_void, err: *mut ErrBuf) -> Status {
    guard(err, || {
        // SAFETY: a live instance; the component is left alone.
        match unsafe { &beside::<C>(this).safe } {
            Some(handle) => settle(err, handle.make_safe()),
            // SAFETY: a class without a handle does not say `safe_from_any_thread`: the call is serialised as
            // any other.
            None => settle(err, unsafe { component::<C>(this) }.make_safe()),
        }
    })
}

unsafe extern "C" fn step<C: Class>(this: *mut c_void, tick: *const abi::Tick, err: *mut ErrBuf) -> Status {
    // SAFETY: the table's contract; `Tick` is transparent over `abi::Tick`.
    let (component, host) = unsafe { (component::<C>(this), &beside::<C>(this).host) };
    // SAFETY: as above.
    let tick = unsafe { &*tick.cast::<Tick>() };
    host.step_begins(tick.0.now_ns);
    let status = guard(err, || settle(err, component.step(tick)));
    host.step_ended();
    status
}

unsafe extern "C" fn command<C: Class>(
    this: *mut c_void,
    id: u32,
    arg: *const c_void,
    ret: *mut c_void,
    err: *mut ErrBuf,
) -> Status {
    // SAFETY: the table's contract: a live instance, pointers to the described types.
    guard(err, || unsafe {
        component::<C>(this).command(id, &own::<C>(this).bound, &mut Call::new(arg, ret, err))
    })
}

unsafe extern "C" fn read<C: Class>(
    state_row: *const c_void,
    id: u32,
    arg: *const c_void,
    ret: *mut c_void,
    err: *mut ErrBuf,
) -> Status {
    guard(err, || {
        let row = state_row.cast::<C::State>();
        // SAFETY: pointers to the described types, by the table's contract.
        let mut call = unsafe { Call::new(arg, ret, err) };
        if size_of::<C::State>() == 0 || row.is_null() {
            return C::read(&C::State::zeroed(), id, &mut call);
        }
        if row.is_aligned() {
            // SAFETY: a readable row that nobody writes during the call.
            C::read(unsafe { &*row }, id, &mut call)
        } else {
            // SAFETY: as above, without the alignment.
            C::read(&unsafe { row.read_unaligned() }, id, &mut call)
        }
    })
}

unsafe extern "C" fn on_event<C: Class>(
    this: *mut c_void,
    id: u32,
    payload: *const c_void,
    err: *mut ErrBuf,
) -> Status {
    guard(err, || {
        // SAFETY: the table's contract: a live instance, a payload of the described type.
        unsafe {
            let mut call = Call::new(payload, core::ptr::null_mut(), err);
            component::<C>(this).on_event(id, &own::<C>(this).bound, &mut call)
        }
    })
}

unsafe extern "C" fn on_service<C: Class>(this: *mut c_void, token: u64, reply: Bytes) -> Status {
    let no_buffer = core::ptr::null_mut();
    guard(no_buffer, || {
        // SAFETY: a live instance and readable bytes.
        let (component, beside, reply) = unsafe { (component::<C>(this), beside::<C>(this), slice(reply)) };
        let done = component.service_reply(token, &String::from_utf8_lossy(reply));
        // There is no buffer for its words.
        settle(
            no_buffer,
            done.inspect_err(|e| log::error!("{}: {}", beside.host.instance_name(), Chain(&**e))),
        )
    })
}

unsafe extern "C" fn state_copy<C: Class>(this: *mut c_void, dst: *mut c_void, len: usize) {
    // SAFETY: a live instance; only fields are copied here, so nothing can panic.
    let row = unsafe { component::<C>(this) }.state();
    if len >= size_of::<C::State>() {
        // SAFETY: the host gives `len` writable bytes.
        unsafe { dst.cast::<C::State>().write_unaligned(row) };
    }
}

unsafe extern "C" fn snapshot<C: Class>(this: *mut c_void, sink: *const Sink) -> Status {
    guard(core::ptr::null_mut(), || {
        // SAFETY: a live instance and a sink that is valid for the call.
        let (component, sink) = unsafe { (component::<C>(this), &*sink) };
        let taken = component.snapshot();
        if !taken.is_empty() {
            // SAFETY: the sink's own context; the bytes live through the call.
            unsafe { (sink.write)(sink.ctx, Bytes { ptr: taken.as_ptr(), len: taken.len() }) };
        }
        STATUS_OK
    })
}

unsafe extern "C" fn restore<C: Class>(
    this: *mut c_void,
    state: Bytes,
    snapshot: Bytes,
    err: *mut ErrBuf,
) -> Status {
    guard(err, || {
        // SAFETY: a live instance and readable bytes.
        let (component, state, taken) = unsafe { (component::<C>(this), slice(state), slice(snapshot)) };
        if !state.is_empty() {
            let Some(row) = crate::payload::from_bytes::<C::State>(state) else {
                let want = size_of::<C::State>();
                let why = format_args!("the state block has {} bytes, this class's has {want}", state.len());
                return refuse(err, STATUS_INVALID, &why);
            };
            component.set_state(&row);
        }
        settle(err, if taken.is_empty() { Ok(()) } else { component.restore(taken) })
    })
}

/// The plugin's `init`: log forwarding and panic hook.
///
/// # Safety
/// `host` is null or valid as long as the library is loaded.
pub unsafe extern "C" fn init(host: *const HostTable) -> Status {
    guard(core::ptr::null_mut(), || {
        crate::forward::install(host);
        STATUS_OK
    })
}

/// Static text for a table.
pub const fn text(text: &'static str) -> Bytes {
    Bytes { ptr: text.as_ptr(), len: text.len() }
}
