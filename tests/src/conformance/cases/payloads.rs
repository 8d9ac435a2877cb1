//! Payloads of every kind between JSON and bytes: what is right comes back as it went, what is wrong never
//! arrives.

use serde_json::{Value, json};

use super::super::{Lab, Way};

/// Something of every kind.
fn all() -> Value {
    json!({
        "order": { "what": 1, "how": 0, "threads": 2, "times": 3, "arg": -0.5, "deadline_ns": 9_007_199_254_740_991_u64 },
        "list": [1.0, -2.5],
        "text": "grün",
        "array": [1, 2, 3, 4_294_967_295_u32],
        "stamp": 7,
        "mood": "BUSY",
        "level": -32_768,
        "on": true,
        "tiny": -128,
    })
}

fn with(field: &str, value: Value) -> Value {
    let mut all = all();
    *all.pointer_mut(field).unwrap_or_else(|| panic!("there is no {field}")) = value;
    all
}

fn mirrored(lab: &Lab, all: Value) -> Value {
    let reply = lab.invoke("server/ctl/mirror", Some(all.clone()), false);
    reply.unwrap_or_else(|refusal| panic!("{all}: {refusal}")).value.unwrap_or_default()
}

pub fn every_kind_of_payload_comes_back_as_it_went(way: &Way) {
    let lab = Lab::running(way);
    assert_eq!(mirrored(&lab, all()), all());
    let fitting = [
        ("/list", json!([])),
        ("/list", json!([1.0, 2.0, 3.0, 4.0])),
        ("/text", json!("")),
        ("/text", json!("sixteen bytes ok")),
        ("/mood", json!("CALM")),
        ("/on", json!(false)),
        ("/order/times", json!(0)),
    ];
    for (field, value) in fitting {
        assert_eq!(mirrored(&lab, with(field, value.clone())), with(field, value), "{field}");
    }
    // Beyond what a double holds exactly a number comes as text, and may be given as either.
    let largest = json!(u64::MAX.to_string());
    for given in [json!(u64::MAX), largest.clone()] {
        assert_eq!(mirrored(&lab, with("/order/deadline_ns", given))["order"]["deadline_ns"], largest);
    }
    // A value without a name is a number, and stays one.
    assert_eq!(mirrored(&lab, with("/mood", json!(7)))["mood"], json!(7));
}

pub fn json_that_does_not_fit_its_payload_is_refused_with_the_place(way: &Way) {
    let lab = Lab::running(way);
    let wrong = [
        ("/list", json!([1.0, 2.0, 3.0, 4.0, 5.0]), "list"),
        ("/list", json!([1.0, "2"]), "list"),
        ("/list", json!({ "len": 1 }), "list"),
        ("/text", json!("seventeen bytes!!"), "text"),
        ("/text", json!(5), "text"),
        ("/array", json!([1, 2, 3]), "array"),
        ("/array", json!([1, 2, 3, -4]), "array"),
        ("/array", json!([1, 2, 3, 4.5]), "array"),
        ("/stamp", json!(-1), "stamp"),
        ("/mood", json!("MERRY"), "mood"),
        ("/mood", json!(-1), "mood"),
        ("/level", json!(32_768), "level"),
        ("/on", json!("yes"), "on"),
        ("/tiny", json!(128), "tiny"),
        ("/order", json!(3), "order"),
        ("/order/arg", json!("much"), "arg"),
        ("/order/times", json!(4_294_967_296_u64), "times"),
    ];
    for (field, value, place) in wrong {
        let bad = with(field, value.clone());
        let refused = lab.invoke("server/ctl/mirror", Some(bad), false);
        let refused = refused.err().unwrap_or_else(|| panic!("{field}: {value} was taken"));
        assert_eq!(refused.reason(), "ARGUMENT_INVALID", "{field}: {value}: {refused}");
        assert!(refused.to_string().contains(place), "{field}: {value}: {refused}");
    }
    let unknown = json!({ "order": {}, "lsit": [] });
    for bad in [unknown, json!(null), json!([]), json!("all")] {
        let refused = lab.invoke("server/ctl/mirror", Some(bad.clone()), false);
        let refused = refused.err().unwrap_or_else(|| panic!("{bad} was taken"));
        assert_eq!(refused.reason(), "ARGUMENT_INVALID", "{bad}: {refused}");
    }
    assert_eq!(mirrored(&lab, all()), all(), "nothing of it did harm");
}

pub fn a_command_without_an_argument_takes_none_and_one_with_takes_one(way: &Way) {
    let lab = Lab::running(way);
    for (member, arg) in
        [("poke", Some(json!(1.0))), ("write", None), ("value", Some(json!(1))), ("scaled", None)]
    {
        let refused = lab.invoke(&format!("server/ctl/{member}"), arg.clone(), false);
        let refused = refused.err().unwrap_or_else(|| panic!("{member} took {arg:?}"));
        assert_eq!(refused.reason(), "ARGUMENT_INVALID", "{member} {arg:?}: {refused}");
    }
    assert_eq!((lab.count("server", "pokes"), lab.count("server", "writes")), (0, 0));
}
