//! Every kind of command, read, event and handler, through the C table.
#![allow(clippy::unwrap_used)]
#![forbid(unsafe_code)]

use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
struct Pair {
    a: f64,
    b: f64,
}

/// One of everything.
#[derive(Component)]
#[component(provides("math", "admin"), requires("alarm"), model = "none")]
struct Everything {
    #[required(interface = "robot")]
    servo: Function<Pair>,
    #[required(interface = "robot", optional)]
    status: Function<(), u32>,
    #[required]
    hold: Function,
    #[event("math")]
    done: Event<Pair>,
    #[event("extra", name = "Tick")]
    tick: Event,
    #[state]
    small: Flag,
    #[state]
    sum: f64,
    #[state]
    count: u32,
    #[host]
    host: Host,
    seen: Vec<u32>,
}

/// Arithmetic.
#[provides("math", tag = "truth")]
impl Everything {
    #[command]
    fn reset(&mut self) {
        (self.sum, self.count) = (0.0, 0);
    }

    #[command(overflow = "latest_wins")]
    fn add(&mut self, #[arg(unit = "m", min = -1.5, max = 2, doc = "What to add")] value: &Pair) {
        self.sum += value.a + value.b;
        self.count += 1;
        self.small = (self.sum < 10.0).into();
        self.done.emit(*value);
    }

    #[command]
    fn next(&mut self) -> u32 {
        self.count += 1;
        self.count
    }

    /// Refuses to divide by zero.
    #[command(unit = "1/m")]
    fn divide(&mut self, by: f64) -> Result<f64, String> {
        if by == 0.0 { Err("by: 0 has no inverse".to_string()) } else { Ok(self.sum / by) }
    }

    #[read(unit = "m")]
    fn sum(s: &EverythingState) -> f64 {
        s.sum
    }

    #[read]
    fn scaled(s: &EverythingState, factor: f64) -> Result<f64> {
        if factor.is_nan() { Err("factor is no number".into()) } else { Ok(s.sum * factor) }
    }

    /// Not a command: has no attribute.
    fn helper(&self) -> usize {
        self.seen.len()
    }
}

#[provides("admin")]
impl Everything {
    #[command(name = "Rename")]
    fn rename(&mut self, name: Text<16>) -> Text<16> {
        Text::new(&format!("{}!", name.as_str()))
    }

    #[command]
    fn ask(&mut self) {
        self.host.service(7, r#"{"verb":"List"}"#);
    }
}

/// What the robot tells.
#[handles("robot")]
impl Everything {
    #[on]
    fn moved(&mut self, to: Pair) {
        self.sum = to.a;
    }

    #[on(name = "Fault", optional)]
    fn fault(&mut self, code: &u32) -> Result {
        self.seen.push(*code);
        if *code > 100 { Err("unknown fault code".into()) } else { Ok(()) }
    }
}

#[handles("alarm")]
impl Everything {
    #[on]
    fn rang(&mut self) {
        self.count = 99;
    }
}

impl Component for Everything {
    fn step(&mut self, _: &Tick) -> Result {
        self.tick.emit(());
        self.servo.send(Pair { a: 1.0, b: self.helper() as f64 });
        self.hold.send(());
        self.sum = self.status.call(()).map_or(-1.0, f64::from);
        Ok(())
    }
    fn service_reply(&mut self, token: u64, reply: &str) -> Result {
        self.sum = token as f64 + reply.len() as f64;
        Ok(())
    }
}

fn bench() -> Bench<Everything> {
    Bench::new("{}")
}

#[test]
fn void_and_write_commands_change_the_state() {
    let mut b = bench();
    b.command::<Pair, ()>("add", Pair { a: 1.0, b: 2.0 }).unwrap();
    assert_eq!((b.state().sum, b.state().count, b.state().small.get()), (3.0, 1, true));
    assert_eq!(b.events::<Pair>("math/done"), [Pair { a: 1.0, b: 2.0 }]);
    b.command::<(), ()>("reset", ()).unwrap();
    assert_eq!(b.state().sum, 0.0);
}

#[test]
fn returning_commands_answer_and_explain_a_failure() {
    let mut b = bench();
    assert_eq!(b.command::<(), u32>("next", ()).unwrap(), 1);
    b.command::<Pair, ()>("add", Pair { a: 4.0, b: 0.0 }).unwrap();
    assert_eq!(b.command::<f64, f64>("math/divide", 2.0).unwrap(), 2.0);
    assert_eq!(b.command::<f64, f64>("divide", 0.0).unwrap_err().reason, "by: 0 has no inverse");
}

#[test]
fn reads_and_qualified_reads_see_the_published_row() {
    let mut b = bench();
    b.command::<Pair, ()>("add", Pair { a: 4.0, b: 0.5 }).unwrap();
    assert_eq!(b.read::<(), f64>("sum", ()).unwrap(), 4.5);
    assert_eq!(b.read::<f64, f64>("scaled", 2.0).unwrap(), 9.0);
    assert_eq!(b.read::<f64, f64>("scaled", f64::NAN).unwrap_err().reason, "factor is no number");
}

#[test]
fn ids_go_on_over_the_interfaces() {
    let mut b = bench();
    let name = b.command::<Text<16>, Text<16>>("admin/Rename", Text::new("eye")).unwrap();
    assert_eq!(name, "eye!");
}

#[test]
fn functions_of_one_interface_and_a_lone_one_reach_their_peers() {
    let mut b = bench();
    b.answer("robot/status", |()| Ok(5u32));
    b.step(1);
    assert_eq!(b.calls::<Pair>("servo"), [Pair { a: 1.0, b: 0.0 }]);
    assert_eq!(b.calls::<()>("hold/hold").len(), 1);
    assert_eq!(b.events::<()>("extra/Tick").len(), 1);
    assert_eq!(b.state().sum, 5.0);
    b.answer("status", |()| Err::<u32, _>("no".to_string()));
    b.step(1);
    assert_eq!(b.state().sum, -1.0);
}

#[test]
fn handlers_take_payloads_by_value_by_reference_and_not_at_all() {
    let mut b = bench();
    b.emit("robot/moved", Pair { a: 8.0, b: 0.0 }).unwrap();
    assert_eq!(b.state().sum, 8.0);
    b.emit("Fault", 3u32).unwrap();
    assert_eq!(b.emit("Fault", 101u32).unwrap_err().reason, "unknown fault code");
    b.emit("alarm/rang", ()).unwrap();
    assert_eq!(b.state().count, 99);
}

#[test]
fn services_are_asked_for_with_a_token_and_answered_later() {
    let mut b = bench();
    b.command::<(), ()>("ask", ()).unwrap();
    assert_eq!(b.services(), [(7, r#"{"verb":"List"}"#.to_string())]);
    b.reply(7, "{}").unwrap();
    assert_eq!(b.state().sum, 9.0);
}

#[test]
#[should_panic(expected = "argument of `add` has type Pair, the test uses f64")]
fn the_bench_refuses_a_wrong_type() {
    let _ = bench().command::<f64, ()>("add", 1.0);
}

#[test]
#[should_panic(expected = "no command `ad`, did you mean `math/add`?; there are math/reset, math/add")]
fn the_bench_lists_what_exists() {
    let _ = bench().command::<f64, ()>("ad", 1.0);
}

mod manifest {
    //! The same class as a host sees it.
    use super::Everything;
    use trocar_plugin_api::desc::PluginDesc;
    use trocar_plugin_api::manifest::{Manifest, Type};
    use trocar_sdk::Class;

    fn manifest() -> Manifest {
        const PLUGIN: PluginDesc = PluginDesc {
            name: "test",
            version: "0.0.0",
            vendor: "",
            license: "",
            doc: "",
            built_with: "",
            unload: false,
            classes: &[Everything::DESC],
        };
        const LEN: usize = trocar_plugin_api::render::<0>(&PLUGIN).1;
        Manifest::parse(&trocar_plugin_api::render::<LEN>(&PLUGIN).0).unwrap()
    }

    #[test]
    fn kinds_follow_from_signatures() {
        let m = manifest();
        let kinds: Vec<_> =
            m.classes[0].provided[0].commands.iter().map(|c| (c.name.as_str(), c.kind.as_str())).collect();
        assert_eq!(
            kinds,
            [
                ("reset", "void"),
                ("add", "write"),
                ("next", "void_return"),
                ("divide", "write_return"),
                ("sum", "read"),
                ("scaled", "qualified_read")
            ]
        );
    }

    #[test]
    fn arguments_carry_name_doc_unit_and_limits() {
        let m = manifest();
        let add = &m.classes[0].provided[0].commands[1];
        let arg = add.arg.as_ref().unwrap();
        assert_eq!((arg.name.as_str(), arg.doc.as_str(), arg.unit.as_str()), ("value", "What to add", "m"));
        assert_eq!((arg.min, arg.max), (Some(-1.5), Some(2.0)));
        assert_eq!(add.overflow, "latest_wins");
        assert_eq!(m.classes[0].provided[0].commands[3].ret_unit, "1/m");
    }

    #[test]
    fn interfaces_come_in_order_with_doc_tag_and_events() {
        let m = manifest();
        let p = &m.classes[0].provided;
        let names: Vec<_> = p.iter().map(|p| p.name.as_str()).collect();
        assert_eq!(names, ["math", "admin", "extra"]);
        assert_eq!((p[0].doc.as_str(), p[0].tag.as_str()), ("Arithmetic.", "truth"));
        assert_eq!((p[2].events[0].name.as_str(), p[2].commands.len()), ("Tick", 0));
    }

    #[test]
    fn required_interfaces_group_functions_and_handlers() {
        let m = manifest();
        let r = &m.classes[0].required;
        let names: Vec<_> =
            r.iter().map(|r| (r.name.as_str(), r.functions.len(), r.handlers.len())).collect();
        assert_eq!(names, [("robot", 2, 2), ("hold", 1, 0), ("alarm", 0, 1)]);
        assert!(!r[0].optional && r[0].functions[1].optional && r[0].handlers[1].optional);
        assert_eq!(r[0].doc, "What the robot tells.");
    }

    #[test]
    fn gaps_of_the_state_are_filled_and_not_listed() {
        let m = manifest();
        assert_eq!(m.classes[0].state, Some(Type::Ref { name: "EverythingState".into() }));
        let fields: Vec<_> =
            m.named("EverythingState").unwrap().fields.iter().map(|f| (f.name.as_str(), f.at)).collect();
        assert_eq!(fields, [("small", 0), ("sum", 8), ("count", 16)]);
        assert_eq!(m.named("EverythingState").unwrap().size, 24);
    }
}
