//! Configurations: accepted values, refused values and the words of a refusal.
#![allow(clippy::unwrap_used)]
#![forbid(unsafe_code)]

use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

#[derive(Config)]
struct Cfg {
    /// Port of the device
    port: String,
    #[config(min = 0, max = 10, unit = "N", default = [1.0, 2.0, 3.0])]
    limits: [f64; 3],
    #[config(one_of = ["bm", "sgm"], default = "bm")]
    method: String,
    #[config(live, default = -3)]
    offset: i8,
    #[config(default = None, unit = "s", min = 0.5)]
    timeout_s: Option<f64>,
    #[config(default = [])]
    names: Vec<String>,
    #[config(default = true)]
    verbose: bool,
    #[config(default = 1e-3, max = 1.0)]
    small: f32,
}

#[derive(Component)]
#[component(model = "none")]
struct Device {
    #[state]
    configured: u32,
    #[state]
    offset: i32,
    #[config]
    cfg: Cfg,
}

impl Component for Device {
    fn configure(&mut self) -> Result {
        if self.cfg.port == "nowhere" {
            return Err("port: nowhere is no device".into());
        }
        self.configured += 1;
        self.offset = i32::from(self.cfg.offset);
        Ok(())
    }
    fn start(&mut self) -> Result {
        let c = &self.cfg;
        let text = format!(
            "{} {:?} {} {} {:?} {:?} {} {}",
            c.port, c.limits, c.method, c.offset, c.timeout_s, c.names, c.verbose, c.small
        );
        Err(text.into())
    }
}

#[track_caller]
fn refused(json: &str) -> String {
    let mut bench = Bench::<Device>::created();
    bench.configure(json).unwrap_err().reason
}

#[test]
fn defaults_fill_what_is_not_given() {
    let mut bench = Bench::<Device>::ready(r#"{"port": "a"}"#);
    assert_eq!(bench.start().unwrap_err().reason, r#"a [1.0, 2.0, 3.0] bm -3 None [] true 0.001"#);
}

#[test]
fn everything_can_be_given() {
    let mut bench = Bench::<Device>::ready(
        r#"{"port": "b", "limits": [0, 5, 10], "method": "sgm", "offset": 4, "timeout_s": 0.5,
            "names": ["x"], "verbose": false, "small": 1}"#,
    );
    assert_eq!(bench.start().unwrap_err().reason, r#"b [0.0, 5.0, 10.0] sgm 4 Some(0.5) ["x"] false 1"#);
}

#[test]
fn each_mistake_names_the_field_and_the_remedy() {
    for (json, want) in [
        ("{}", "port: is required and has no default"),
        (r#"{"port": 1}"#, "port: 1 is not text"),
        (
            r#"{"port": "a", "prot": 1}"#,
            "prot: no such setting; there is port, limits, method, offset, timeout_s, names, verbose, small",
        ),
        (r#"{"port": "a", "limits": [1, 2, 11]}"#, "limits[2]: 11 N is above 10 N"),
        (r#"{"port": "a", "limits": [1, 2]}"#, "limits: [1,2] is not a list of the right length (3 items)"),
        (r#"{"port": "a", "method": "xx"}"#, r#"method: "xx" is not one of "bm", "sgm""#),
        (r#"{"port": "a", "offset": 200}"#, "offset: 200 is not a whole number that fits"),
        (r#"{"port": "a", "offset": 1.5}"#, "offset: 1.5 is not a whole number that fits"),
        (r#"{"port": "a", "timeout_s": 0.1}"#, "timeout_s: 0.1 s is below 0.5 s"),
        (r#"{"port": "a", "verbose": 1}"#, "verbose: 1 is not true or false"),
        ("[]", "the configuration is not a JSON object: invalid type: sequence, expected a map"),
    ] {
        assert_eq!(refused(json), want, "for {json}");
    }
}

#[test]
fn broken_json_is_refused_with_its_place() {
    assert!(refused(r#"{"port": "#).starts_with("the configuration is not a JSON object: EOF while parsing"));
}

#[test]
fn a_refusal_by_the_component_leaves_the_old_configuration() {
    let mut bench = Bench::<Device>::ready(r#"{"port": "a", "offset": 7}"#);
    let refused = bench.configure(r#"{"port": "nowhere", "offset": 8}"#).unwrap_err();
    assert_eq!(refused.reason, "port: nowhere is no device");
    assert_eq!((bench.state().configured, bench.state().offset), (1, 7));
    assert!(bench.start().unwrap_err().reason.starts_with("a "));
}

#[test]
fn schemas_say_types_limits_and_choices() {
    let schemas: Vec<_> =
        <Cfg as trocar_sdk::Config>::FIELDS.iter().map(|f| (f.schema, f.min, f.max)).collect();
    assert_eq!(schemas[0], (r#""type":"string""#, "", ""));
    let items =
        r#""type":"array","items":{"type":"number","minimum":0,"maximum":10},"minItems":3,"maxItems":3"#;
    assert_eq!(schemas[1], (items, "", ""));
    assert_eq!(schemas[2], (r#""type":"string","enum":["bm","sgm"]"#, "", ""));
    assert_eq!(schemas[3], (r#""type":"integer""#, "-128", "127"));
    assert_eq!(schemas[4], (r#""type":["number","null"]"#, "0.5", ""));
}

#[test]
fn a_default_that_is_not_valid_is_refused_as_if_it_were_given() {
    use trocar_sdk::__private::{ConfigFieldDesc, JsonObject, config_field};
    let limit = |default: &'static str| ConfigFieldDesc {
        name: "limit",
        doc: "",
        schema: "\"type\":\"number\"",
        unit: "mm",
        min: "0",
        max: "10",
        default,
        live: true,
    };
    let said = |default| config_field::<f64>(&JsonObject::new(), &limit(default)).map_err(|e| e.to_string());
    assert_eq!(said("\"x\"").unwrap_err(), "limit: \"x\" is not a number");
    assert_eq!(said("20").unwrap_err(), "limit: 20 mm is above 10 mm");
    assert!(said("x").unwrap_err().starts_with("limit: its default x is not valid JSON"));
    assert_eq!(said("5").unwrap(), 5.0);
}
