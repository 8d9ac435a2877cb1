//! Reads computed from rows that another process wrote, or from other bytes.
#![allow(clippy::unwrap_used)]

use std::ffi::c_void;
use std::os::fd::{BorrowedFd, OwnedFd};
use std::sync::atomic::AtomicBool;

use trocar_model::{Arg, CommandKind, Field, Overflow, Prim, Provided, Safety, StructType, Type};
use trocar_plugin_api::abi::{ClassTable, EXECUTED, FAILED, STATUS_FAILED, STATUS_OK, Status};
use trocar_rt::region::Layout;
use trocar_rt::segment::{Agreed, CallShape, RemoteCalls, Rows, ServedCalls};
use trocar_rt::state::StateWriter;

use super::super::puppet::class;
use super::super::texts::write_err;
use super::*;

const FLAGS: usize = 8;
const ITEMS: usize = 4;

/// The state as a class sees it: flags, then a list.
#[repr(C)]
struct Row {
    flags: [u8; FLAGS],
    len: u64,
    items: [f64; ITEMS],
}

const ROW: usize = size_of::<Row>();
/// Numbers of the class's reads.
const SUM: u32 = 0;
const SCALED: u32 = 1;
const WHOLE: u32 = 2;
const FAILS: u32 = 3;

unsafe extern "C" fn read(
    row: *const c_void,
    id: u32,
    arg: *const c_void,
    ret: *mut c_void,
    err: *mut ErrBuf,
) -> Status {
    // SAFETY: a row of the class, checked by the caller, as are argument and place of the number.
    unsafe {
        let row = &*row.cast::<Row>();
        if row.flags.iter().any(|flag| *flag > 1) || row.len > ITEMS as u64 {
            write_err(err, b"no value of the state's type");
            return STATUS_FAILED;
        }
        let sum: f64 = row.items[..row.len as usize].iter().sum();
        match id {
            SUM => ret.cast::<f64>().write(sum),
            SCALED => ret.cast::<f64>().write(sum * arg.cast::<f64>().read()),
            WHOLE => {
                let mut all = [0; MAX_PAYLOAD];
                std::ptr::copy_nonoverlapping(arg.cast::<u8>(), all.as_mut_ptr(), MAX_PAYLOAD);
                std::ptr::copy_nonoverlapping(all.as_ptr(), ret.cast::<u8>(), MAX_PAYLOAD);
            }
            FAILS => {
                write_err(err, b"as it was asked to");
                return STATUS_PANICKED;
            }
            _ => return STATUS_FAILED,
        }
    }
    STATUS_OK
}

fn number() -> Type {
    Type::Prim(Prim::F64)
}

fn whole() -> Type {
    Type::Array { item: Box::new(Type::Prim(Prim::U8)), n: MAX_PAYLOAD }
}

fn state() -> Type {
    let field = |name: &str, at, ty| Field {
        name: name.into(),
        at,
        ty,
        unit: String::new(),
        doc: String::new(),
        frame: String::new(),
    };
    let flags = Type::Array { item: Box::new(Type::Prim(Prim::Bool)), n: FLAGS };
    let items = Type::List { item: Box::new(number()), n: ITEMS };
    let fields = vec![field("flags", 0, flags), field("items", 8, items)];
    let all = StructType { name: "Row".into(), doc: String::new(), size: ROW, align: 8, fields };
    Type::Struct(Arc::new(all))
}

fn command(name: &str, arg: Option<Type>, ret: Type) -> Command {
    let arg = arg.map(|ty| Arg {
        name: "x".into(),
        ty,
        unit: String::new(),
        doc: String::new(),
        min: None,
        max: None,
    });
    let kind = if arg.is_some() { CommandKind::QualifiedRead } else { CommandKind::Read };
    Command {
        name: name.into(),
        doc: String::new(),
        kind,
        arg,
        ret: Some(ret),
        ret_unit: String::new(),
        overflow: Overflow::Reject,
    }
}

fn commands() -> Vec<Command> {
    vec![
        command("sum", None, number()),
        command("scaled", Some(number()), number()),
        command("whole", Some(whole()), whole()),
        command("fails", None, number()),
    ]
}

fn ports(commands: Vec<Command>) -> Ports {
    let provided = Provided {
        name: "ctl".into(),
        doc: String::new(),
        tag: trocar_model::Tag::None,
        commands,
        events: Vec::new(),
    };
    Ports { provided: vec![provided], state: Some(state()), ..Ports::default() }
}

/// A class whose table has only reads.
fn own() -> OwnClass {
    // SAFETY: a table of null entries but the size, which `Hot` asks for, and the read.
    let mut table: ClassTable = unsafe { std::mem::zeroed() };
    table.struct_size = size_of::<ClassTable>() as u32;
    table.read = Some(read);
    let table: &'static ClassTable = Box::leak(Box::new(table));
    // SAFETY: leaked, so it lives for ever.
    let class_here = unsafe { LoadedClass::new(table, Arc::new(())) };
    OwnClass { info: Arc::new(class(ports(commands()), Safety::None)), class: class_here }
}

/// Both ends of one server's rows and of the numbers of its reads.
struct Scene {
    own: OwnClass,
    panics: Arc<Panics>,
    rows: Rows<StateWriter>,
    numbers: ServedCalls,
    seen: Arc<OwnRows>,
    theirs: Vec<Word>,
}

const AGREED: Agreed = Agreed { hash: 1, epoch: 2 };

fn file(of: Option<BorrowedFd<'_>>) -> OwnedFd {
    of.unwrap().try_clone_to_owned().unwrap()
}

impl Scene {
    fn set() -> Scene {
        let (own, panics) = (own(), Arc::new(Panics::default()));
        let rows = Rows::create(ROW, AGREED).unwrap();
        let theirs = file(rows.region().unwrap().fd());
        let seen = Rows::<StateReader>::open(theirs, ROW, AGREED).unwrap();
        let shape = CallShape {
            depth: 1,
            commands: 4,
            arg_bytes: 8,
            reply_cells: 1,
            ret_bytes: 8,
            text_bytes: 8,
            event_bytes: 8,
            reads: Vec::new(),
            own_reads: 4,
        };
        let numbers = ServedCalls::create(&shape, AGREED).unwrap();
        let there = RemoteCalls::open(file(numbers.fd()), &shape, AGREED).unwrap();
        let seen = OwnRows::new(&own, seen.end, panics.clone());
        Scene { own, panics, rows, numbers, seen, theirs: there.own_reads }
    }

    /// The read with this number in a description that has these commands.
    fn read(&mut self, id: u32, told: Vec<Command>) -> OwnRead {
        let at = self.theirs.remove(0);
        let told = class(ports(told), Safety::None).ports;
        OwnRead::new(&self.seen, at, &commands()[id as usize], &self.own, &told)
    }

    /// Sets the number that the server's process gives to the first, second … of the reads that were made.
    fn number(&self, read: usize, word: u64) {
        self.numbers.own_reads[read].set(word);
    }

    fn publish(&mut self, row: &[u8; ROW]) {
        self.rows.end.publish(7, 1, |place| place.copy_from_slice(row));
    }
}

fn row(items: &[f64]) -> [u8; ROW] {
    let mut row = [0; ROW];
    row[..2].copy_from_slice(&[1, 0]);
    row[8..16].copy_from_slice(&(items.len() as u64).to_ne_bytes());
    for (place, item) in row[16..].chunks_exact_mut(8).zip(items) {
        place.copy_from_slice(&item.to_ne_bytes());
    }
    row
}

/// Outcome, result and sentence.
fn call(read: &OwnRead, arg: f64) -> Option<(Outcome, f64, String)> {
    let (mut ret, mut text) = ([0.0f64, -1.0], [0u8; 64]);
    let mut err = ErrBuf { ptr: text.as_mut_ptr(), cap: text.len(), len: 0 };
    let (arg, place) = ((&raw const arg).cast(), ret.as_mut_ptr().cast());
    let (outcome, _) = read.call(arg, place, &raw mut err)?;
    assert_eq!(ret[1], -1.0, "more was written than the result has");
    Some((outcome, ret[0], super::super::sentence(&raw mut err)))
}

#[test]
fn a_read_is_worked_out_from_the_newest_row_and_by_the_number_it_has_now() {
    let mut scene = Scene::set();
    let (sum, scaled) = (scene.read(SUM, commands()), scene.read(SCALED, commands()));
    assert_eq!(call(&sum, 0.0).unwrap().0, DISABLED, "it was given no number yet");
    scene.number(0, u64::from(SUM) + 1);
    scene.number(1, u64::from(SCALED) + 1);
    assert_eq!(call(&sum, 0.0).unwrap().0, NOT_ACTIVE, "no row was published yet");
    scene.publish(&row(&[1.0, 2.0]));
    assert_eq!(call(&sum, 0.0).unwrap(), (EXECUTED, 3.0, String::new()));
    assert_eq!(call(&scaled, 4.0).unwrap(), (EXECUTED, 12.0, String::new()));
    scene.number(0, 0);
    assert_eq!(call(&sum, 0.0).unwrap().0, DISABLED, "it was withdrawn");
}

#[test]
fn a_number_of_another_command_is_asked_for() {
    let mut scene = Scene::set();
    let scaled = scene.read(SCALED, commands());
    scene.publish(&row(&[1.0]));
    for id in [SUM, WHOLE, FAILS, 4, 5, 6, 1000, u32::MAX] {
        scene.number(0, u64::from(id) + 1);
        assert!(call(&scaled, 1.0).is_none(), "{id}");
    }
    scene.number(0, u64::MAX);
    assert!(call(&scaled, 1.0).is_none());
}

/// A description comes from the other process: the class may have other argument and result types under a
/// number it names.
#[test]
fn a_number_of_a_described_command_has_room_for_whatever_the_class_means_by_it() {
    let mut scene = Scene::set();
    let mut told = commands();
    told.insert(0, command("scaled", Some(number()), number()));
    told[WHOLE as usize] = command("scaled", Some(number()), number());
    let scaled = scene.read(SCALED, told);
    scene.publish(&row(&[1.0, 1.0]));
    scene.number(0, u64::from(WHOLE) + 1);
    assert_eq!(call(&scaled, 5.5).unwrap(), (EXECUTED, 5.5, String::new()), "its own argument came back");
    // The number is now that of the class's first command, which has no argument.
    scene.number(0, u64::from(SUM) + 1);
    assert_eq!(call(&scaled, 5.5).unwrap(), (EXECUTED, 2.0, String::new()));
}

#[test]
fn a_read_that_panics_is_answered_counted_and_told() {
    let mut scene = Scene::set();
    let fails = scene.read(FAILS, commands());
    scene.number(0, u64::from(FAILS) + 1);
    scene.publish(&row(&[]));
    for _ in 0..3 {
        assert_eq!(call(&fails, 0.0).unwrap(), (FAILED, 0.0, "as it was asked to".to_owned()));
    }
    assert_eq!(scene.panics.so_far(), (3, "fails: as it was asked to".to_owned()));
}

#[test]
fn whatever_is_written_over_rows_the_class_sees_values_of_its_type_only() {
    let mut scene = Scene::set();
    let sum = scene.read(SUM, commands());
    scene.number(0, u64::from(SUM) + 1);
    let all = [0xff; ROW];
    scene.publish(&all);
    let (outcome, _, why) = call(&sum, 0.0).unwrap();
    assert_eq!((outcome, why), (EXECUTED, String::new()), "a row of ones");
    let region = scene.rows.region().unwrap();
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let words = Layout::words(&region, 4 * 8);
            let mut random = 1u64;
            while !over.load(Ordering::Relaxed) {
                random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                let (at, how) = (random >> 40, random >> 60);
                let word = &words[at as usize % words.len()];
                let was = word.load(Ordering::Relaxed);
                word.store(if how < 8 { random } else { was.wrapping_add(how) & 0xff }, Ordering::Relaxed);
            }
        });
        for _ in 0..20_000 {
            let (outcome, _, why) = call(&sum, 0.0).unwrap();
            assert!([EXECUTED, NOT_ACTIVE].contains(&outcome), "{outcome}: {why}");
        }
        over.store(true, Ordering::Relaxed);
    });
}
