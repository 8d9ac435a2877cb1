//! Classes that no host would list do not compile: every refusal that the tokens alone give away, with its
//! sentence. Refusals that need the types are in `sdk/rust/tests/refused.rs`.

use crate::{component, handles, payload, provides};
use syn::parse_str;

fn of_component(source: &str) -> String {
    said(component::derive(parse_str(source).expect(source)))
}

fn said(result: syn::Result<proc_macro2::TokenStream>) -> String {
    result.err().map(|e| e.to_string()).unwrap_or_default()
}

#[track_caller]
fn refused(source: &str, said: &str, why: &str) {
    assert!(!why.is_empty() && said.contains(why), "{source}\nsaid: {said:?}\nwanted: {why:?}");
}

#[test]
fn an_execution_that_a_host_refuses_does_not_compile() {
    for (settings, why) in [
        (
            r#"model = "on_signal", rate_hz = 4"#,
            "a rate means nothing to model on_signal, it steps when something arrives: remove rate_hz, or say model periodic or stream",
        ),
        (
            r#"rate_hz = 4, model = "on_callback""#,
            "a rate means nothing to model on_callback, its device says when it runs",
        ),
        (
            r#"model = "continuous", rate_hz = 4"#,
            "a rate means nothing to model continuous, it steps again at once",
        ),
        (r#"model = "none", rate_hz = 4"#, "a rate means nothing to model none, it has no thread of its own"),
        (r#"model = "periodic""#, "a periodic class needs its rate"),
        (r#"model = "exec_in""#, "unknown execution model; there are periodic"),
        ("rate_hz = 1100000", "at most 1e6 Hz"),
        ("rate_hz = 0.0002", "at least 1/3600 Hz"),
        ("rate_hz = 0", "at most 1e6 Hz"),
        ("rate_hz = -1", "at most 1e6 Hz"),
        ("max_step_ms = 0.09", "at least 0.1 ms"),
        ("max_step_ms = 3600001", "at most 3.6e6 ms"),
        (r#"models("sometimes")"#, "unknown execution model; there are periodic"),
        (
            r#"models("on_signal"), rate_hz = 4"#,
            "its own model, periodic, is not among its models, on_signal",
        ),
        ("rates_hz(100)", "rates_hz has two numbers"),
        ("rates_hz(200, 100)", "the lower one first"),
        ("rates_hz(0, 100)", "from 1/3600 Hz to 1e6 Hz"),
        ("rate_hz = 4, rates_hz(100, 1000)", "its own rate, 4 Hz, is not within rates_hz, 100 to 1000 Hz"),
        (r#"safety = "high""#, "safety is actuator, sensor or none"),
    ] {
        refused(settings, &of_component(&format!("#[component({settings})] struct C {{}}")), why);
    }
    for settings in [
        "rate_hz = 1000000",
        "rate_hz = 0.000278",
        r#"model = "stream", rate_hz = 30"#,
        r#"model = "stream""#,
        r#"rate_hz = 1000, models("periodic", "exec_in"), rates_hz(100, 8000)"#,
        "max_step_ms = 0.1",
        "max_step_ms = 3600000",
    ] {
        assert_eq!(of_component(&format!("#[component({settings})] struct C {{}}")), "", "{settings}");
    }
}

#[test]
fn a_name_that_a_host_refuses_does_not_compile() {
    let long = "x".repeat(64);
    for (source, why) in [
        (
            r#"#[component(name = "2nd")] struct C {}"#.to_string(),
            "`2nd` is not a name: it begins with a letter or `_`",
        ),
        (r#"#[component(name = "a.b")] struct C {}"#.into(), "`a.b` is not a name: use letters"),
        (
            format!("#[component(name = {long:?})] struct C {{}}"),
            "it has 64 bytes, and at most 63 are allowed",
        ),
        (
            "struct Größe {}".into(),
            "`größe` is not a name: use letters, digits, `_` and `-`; or give the class one",
        ),
        (
            "struct C { #[input] größe: In<f64> }".into(),
            "`größe` is not a name: use letters, digits, `_` and `-`; or give it one",
        ),
        ("struct C { #[input] system: In<f64> }".into(), "every component has an interface `system` already"),
        (
            "struct C { #[required] system: Function }".into(),
            "every component has an interface `system` already",
        ),
        (
            r#"#[component(provides("system"))] struct C {}"#.into(),
            "every component has an interface `system` already",
        ),
        (
            "struct C { #[output] tap_rows: Out<f64> }".into(),
            "every component has an output `tap_rows` already: choose another name",
        ),
        ("struct C { #[input] x: In<f64>, #[output(name = \"x\")] y: Out<f64> }".into(), "`x` is used twice"),
        (
            r#"struct C { #[event("ctl")] a: Event, #[event("ctl", name = "a")] b: Event }"#.into(),
            "`a` is used twice",
        ),
        (r#"#[component(provides("x"))] struct C { #[input] x: In<f64> }"#.into(), "`x` is used twice"),
    ] {
        refused(&source, &of_component(&source), why);
    }
    for source in [
        "struct C { #[input(name = \"size\")] größe: In<f64>, r#größe: u8 }",
        "struct C { #[input] r#type: In<f64> }",
        "#[component(name = \"size\")] struct Größe {}",
    ] {
        assert_eq!(of_component(source), "", "{source}");
    }
    let made = component::derive(parse_str("struct C { #[input] r#type: In<f64> }").expect("a struct"));
    assert!(made.expect("it compiles").to_string().contains("name : \"type\""), "r# is no part of a name");
}

#[test]
fn a_queue_or_frame_beyond_what_a_host_takes_does_not_compile() {
    for (field, why) in [
        ("#[input(fifo = 65537)] x: In<f64>", "at most 65536 samples wait in an input"),
        ("#[input(fifo = 99999999999999999999999)] x: In<f64>", "at most 65536 samples"),
        ("#[output(max_bytes = 1073741825)] x: Out<Frame<H>>", "at most 1073741824 bytes are in a frame"),
    ] {
        refused(field, &of_component(&format!("struct C {{ {field} }}")), why);
    }
    for field in ["#[input(fifo = 65536)] x: In<f64>", "#[output(max_bytes = 1073741824)] x: Out<Frame<H>>"] {
        assert_eq!(of_component(&format!("struct C {{ {field} }}")), "", "{field}");
    }
}

#[test]
fn a_tag_that_nobody_enforces_does_not_compile() {
    for (field, why) in [
        ("#[input(tag = \"truth\")] x: In<f64>", "`truth` is no tag of this; there are: sim"),
        ("#[output(tag = \"thruth\")] x: Out<f64>", "`thruth` is no tag of this; there are: truth, sim"),
        ("#[required(tag = \"sim\")] x: Function", "unknown setting"),
    ] {
        refused(field, &of_component(&format!("struct C {{ {field} }}")), why);
    }
    for field in ["#[input(tag = \"sim\")] x: In<f64>", "#[output(tag = \"truth\")] x: Out<f64>"] {
        assert_eq!(of_component(&format!("struct C {{ {field} }}")), "", "{field}");
    }
    assert!(parse_str::<provides::InterfaceArgs>("\"truth\", tag = \"truth\"").is_ok());
    let wrong = parse_str::<provides::InterfaceArgs>("\"truth\", tag = \"true\"");
    assert!(wrong.err().expect("refused").to_string().contains("there are: truth, sim"));
}

#[test]
fn members_that_a_host_refuses_do_not_compile() {
    let provided = |methods: &str| {
        let (args, item) = (parse_str("\"ctl\""), parse_str(&format!("impl C {{ {methods} }}")));
        said(provides::expand(args.expect("a name"), item.expect(methods)))
    };
    for (methods, why) in [
        (r#"#[command] fn a(&mut self) {} #[command(name = "a")] fn b(&mut self) {}"#, "`a` is used twice"),
        (
            r#"#[command] fn a(&mut self) {} #[read(name = "a")] fn b(s: &CState) -> f64 { 0.0 }"#,
            "`a` is used twice",
        ),
        ("#[command] fn größer(&mut self) {}", "`größer` is not a name"),
        ("#[read] fn a(s: &CState) {}", "a read returns a value"),
        (
            r#"#[command(overflow = "block")] fn a(&mut self) {}"#,
            "overflow is reject, latest_wins or drop_oldest",
        ),
        ("#[command] fn a(&mut self, #[arg(min = 2, max = 1)] x: f64) {}", "min 2 is above max 1"),
        ("#[command] fn a(&mut self, #[arg(max = 1e999)] x: f64) {}", "larger than any f64"),
        (r#"#[command] fn a(&mut self, #[arg(unit = "newtons")] x: f64) {}"#, "did you mean `N`?"),
    ] {
        refused(methods, &provided(methods), why);
    }
    let handled = |methods: &str| {
        let (args, item) = (parse_str("\"robot\""), parse_str(&format!("impl C {{ {methods} }}")));
        said(handles::expand(args.expect("a name"), item.expect(methods)))
    };
    for (methods, why) in [
        (r#"#[on] fn a(&mut self) {} #[on(name = "a")] fn b(&mut self) {}"#, "`a` is used twice"),
        ("#[on] fn größer(&mut self) {}", "`größer` is not a name"),
        (
            "#[on] fn a(&mut self, #[arg(max = 3)] x: f64) {}",
            "limits are for the arguments of commands; remove",
        ),
        (r#"#[on] fn a(&mut self, #[arg(unit = "mm")] x: f64) {}"#, "where the event is declared"),
    ] {
        refused(methods, &handled(methods), why);
    }
}

#[test]
fn a_payload_that_a_host_refuses_does_not_compile() {
    for (source, why) in [
        ("#[repr(C, packed)] struct P { a: u8, b: f64 }", "a payload is not `packed`"),
        ("#[repr(C, packed(4))] struct P { a: u8, b: f64 }", "a payload is not `packed`"),
        ("#[repr(packed, C)] struct P { a: u8, b: f64 }", "a payload is not `packed`"),
        ("#[repr(align(8))] struct P { a: f64 }", "a payload is `#[repr(C)]`"),
        ("#[repr(C)] enum P { A }", "for named integer values use `named_values!`"),
    ] {
        refused(source, &said(payload::derive(parse_str(source).expect(source))), why);
    }
    let aligned = "#[repr(align(8), C)] struct P { a: f64 }";
    assert_eq!(said(payload::derive(parse_str(aligned).expect(aligned))), "");
}
