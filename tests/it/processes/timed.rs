//! Rates and loads, as `top` and `hz` tell them.
//!
//! Promise: no rate is above that of the sender, and a component that is always busy is shown so. A rate is a
//! number of things in a time of this machine's clock, so only `./tests/run --times` runs these tests.

use trocar_tests::eventually;

use super::TWO;
use super::system::System;
use super::watching::{number, objects, row, stepped, three};

#[test]
fn top_tells_no_rate_above_that_of_its_component_and_how_busy_one_is_that_is_too_slow() {
    let three = three();
    let last = stepped(&three);
    for c in last["components"].as_array().unwrap() {
        assert!(number(c, "rate_hz") < 1100.0, "{c}");
    }
    let late = row(&last, "components", "path", "middle/late");
    assert!(number(late, "load") > 0.9 && number(late, "rate_hz") < 10.0, "{late}");
    let s = row(&last, "components", "path", "left/s");
    assert!(number(s, "load") > 0.0 && number(s, "load") < 1.0, "{s}");
}

#[test]
fn hz_tells_no_rate_above_that_of_the_sender() {
    let two = System::up(TWO, &[]);
    let hz = eventually("both are measured", || {
        let hz = two.trocar().run(&["hz", "left/s/value", "right/s/value", "--json", "-n", "1"]).ends_with(0);
        let lines = objects(&hz.stdout);
        if lines.iter().all(|l| l["seen"].as_u64() > Some(2)) { Ok(lines) } else { Err(format!("{hz:#?}")) }
    });
    for line in &hz {
        assert!(line["rate_hz"].as_f64().is_some_and(|hz| hz > 0.0 && hz < 1100.0), "{line}");
    }
}
