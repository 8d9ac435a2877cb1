//! Lines that are taken, and lines that are not.
#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use trocar_sdk::data::Pose;
use trocar_sdk::from_bytes;

use super::*;

fn plan(outputs: &[&str], format: Format, stamp: &str) -> Plan {
    let outputs: Vec<String> = outputs.iter().map(|text| (*text).to_owned()).collect();
    Plan::of(&outputs, format, stamp, 0).unwrap()
}

/// The f64s of a record, or why there is none.
fn read(plan: &Plan, line: &str) -> Result<Vec<f64>, String> {
    let mut record = plan.blank.clone();
    match plan.read(line.as_bytes(), &mut record)? {
        Line::Nothing => Ok(Vec::new()),
        Line::Record(_) => {
            Ok(record.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect())
        }
    }
}

#[test]
fn numbers_are_taken_whatever_sets_them_apart() {
    let two = plan(&["a: f64", "b: f64"], Format::Numbers, "arrival");
    for line in ["1 -2.5", "1,-2.5", " 1 , -2.5 ", "1;-2.5", "1\t-2.5", "  1e0   -25e-1  "] {
        assert_eq!(read(&two, line).unwrap(), [1.0, -2.5], "{line}");
    }
    for nothing in ["", "   ", "# a, b", "#1,2"] {
        assert_eq!(read(&two, nothing).unwrap(), [0.0; 0], "{nothing}");
    }
}

#[test]
fn a_bad_line_says_what_is_wrong_with_it() {
    let two = plan(&["a: f64", "n: u32"], Format::Numbers, "arrival");
    for (line, why) in [
        ("1", "1 value in it, 2 values wanted"),
        ("1,2,3", "3 values in it, 2 values wanted"),
        ("1,", "column 2: empty"),
        ("x,2", "column 1: `x` is not a number"),
        ("nan,2", "column 1: NaN is not a finite number"),
        ("1e999,2", "column 1: inf is not a finite number"),
        ("1,2.5", "column 2: `2.5` is not a whole number"),
        ("1,-1", "column 2: `-1` does not fit into u32"),
        ("1,4294967296", "column 2: `4294967296` does not fit into u32"),
        ("1,2;3", "column 1: `1,2` is not a number"),
        ("1,\u{1}2", "not text: byte 3 is a control character"),
    ] {
        assert_eq!(read(&two, line).unwrap_err(), why, "{line}");
    }
    let mut record = two.blank.clone();
    let binary = two.read(&[b'1', 0xff, 0x00], &mut record).unwrap_err();
    assert_eq!(binary, "not text: byte 2 is not valid UTF-8");
}

#[test]
fn columns_are_chosen_by_their_number_and_the_stamp_has_one() {
    let chosen = Plan::of(&["a: f64 = 4".into(), "b: f64 = 2".into()], Format::Numbers, "1 ms", 5).unwrap();
    let mut record = chosen.blank.clone();
    assert_eq!(chosen.read(b"1500,2,3,4,5", &mut record), Ok(Line::Record(Some(1.5))));
    assert_eq!(record, [4f64.to_le_bytes(), 2f64.to_le_bytes()].concat());
    // Without a number a field takes the next column, and not that of the stamp.
    let next = plan(&["a: f64", "b: f64[2]"], Format::Numbers, "2 s");
    assert_eq!(read(&next, "1 99 2 3").unwrap(), [1.0, 2.0, 3.0]);
    for far in ["1 1e300 2 3", "1 -5e9 2 3"] {
        let why = read(&next, far).unwrap_err();
        assert!(why.ends_with("e9 s is more than 146 years from 0") || why.contains("1e300 s"), "{why}");
    }
    let few = Plan::of(&["a: f64 = 4".into()], Format::Numbers, "arrival", 3).err().unwrap().to_string();
    assert!(
        few.contains("columns: 3 numbers in a line are too few, the outputs and the stamp take 4"),
        "{few}"
    );
}

#[test]
fn json_is_found_by_name_below_the_output_or_by_its_path() {
    let plan = plan(&["f: x, y = deep.list.1", "tip: Pose", "n: f64"], Format::Json, "t us");
    let line = r#"{"t": 2e6, "f": {"x": 1}, "deep": {"list": [0, 2]}, "position": [3, 4, 5], "orientation": [0, 0, 0, 1], "n": 6}"#;
    let mut record = plan.blank.clone();
    assert_eq!(plan.read(line.as_bytes(), &mut record), Ok(Line::Record(Some(2.0))));
    let pose: Pose = from_bytes(&record[24..88]).unwrap();
    assert_eq!((pose.position, pose.orientation), ([3.0, 4.0, 5.0], [0.0, 0.0, 0.0, 1.0]));
    assert_eq!(read(&plan, line).unwrap()[1..3], [1.0, 2.0]);
    let below = line.replace(
        r#""position": [3, 4, 5], "orientation": [0, 0, 0, 1]"#,
        r#""tip": {"position": [3, 4, 5], "orientation": [0, 0, 0, 1]}"#,
    );
    assert_eq!(read(&plan, &below), read(&plan, line));
    for (from, to, why) in [
        (r#""x": 1"#, r#""z": 1"#, r#"there is no "x" in it"#),
        (r#""x": 1"#, r#""x": "one""#, r#"x: `\"one\"` is not a number"#),
        (r#""x": 1"#, r#""x": NaN"#, "not valid JSON"),
        ("[3, 4, 5]", "[3, 4]", "position: `[3,4]` is not a list of 3 items"),
        ("[0, 2]", "[0]", r#"there is no "deep.list.1" in it"#),
        (r#""t": 2e6"#, r#""t": null"#, "t: `null` is not a number"),
        ("}", "", "not valid JSON"),
    ] {
        let said = read(&plan, &line.replace(from, to)).unwrap_err();
        assert!(said.contains(why), "{to}: {said}");
    }
    assert!(read(&plan, "[1, 2]").unwrap_err().contains("not a JSON object"));
}

#[test]
fn a_payload_of_several_parts_has_columns_side_by_side_or_an_object() {
    let line = "9,1,2,3,0,0,0,1";
    let columns = plan(&["tip: Pose = 2"], Format::Numbers, "1 s");
    assert_eq!(read(&columns, line).unwrap()[1..], [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]);
    let object = plan(&["tip: Pose = arm.tool"], Format::Json, "arrival");
    let line = r#"{"arm": {"tool": {"position": [1, 2, 3], "orientation": [0, 0, 0, 1]}}}"#;
    assert_eq!(read(&object, line).unwrap()[1..], [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]);
}

#[test]
fn whole_numbers_flags_and_words_are_exact() {
    let all = plan(&["a: i64", "b: u64", "c: text[8]"], Format::Numbers, "arrival");
    let mut record = all.blank.clone();
    let line = format!("{} {} {}", i64::MIN, u64::MAX, "µm");
    assert_eq!(all.read(line.as_bytes(), &mut record), Ok(Line::Record(None)));
    let words = [i64::MIN.cast_unsigned(), u64::MAX, 3].map(u64::to_le_bytes).concat();
    assert_eq!((&record[..24], &record[24..27]), (&words[..], "µm".as_bytes()));
    assert!(read(&all, "1 2 123456789").unwrap_err().contains("column 3: `123456789` is longer than 8 B"));
    let flag = plan(&["on: bool"], Format::Numbers, "arrival");
    assert!(read(&flag, "2").unwrap_err().contains("one of 0, 1, false, true"));
}

#[test]
fn settings_that_contradict_each_other_are_refused() {
    let of = |outputs: &[&str], stamp: &str| {
        let outputs: Vec<String> = outputs.iter().map(|text| (*text).to_owned()).collect();
        Plan::of(&outputs, Format::Numbers, stamp, 0).err().map(|e| e.to_string()).unwrap_or_default()
    };
    assert!(of(&[], "arrival").contains("outputs: there are 0"));
    assert!(of(&["a: x"], "t ms").contains("is not a column: they are counted from 1"));
    assert!(of(&["a: x"], "1").contains("stamp: \"1\": not a field and a unit"));
    assert!(of(&["a: x"], "1 min").contains("the unit is not one of s, ms, us, ns"));
    assert!(of(&["a: x = 0"], "arrival").contains("is not a column"));
}

proptest! {
    #[test]
    fn any_bytes_are_a_line(bytes in prop::collection::vec(any::<u8>(), 0..400), text in "[-0-9eE.,; \t{}\\[\\]\":a-z]{0,80}") {
        for format in [Format::Numbers, Format::Json] {
            let plan = plan(&["a: x N, on bool, w[16] text, f[2] f32", "n: i32"], format, if format == Format::Json { "t s" } else { "1 s" });
            let mut record = plan.blank.clone();
            for line in [&bytes[..], text.as_bytes()] {
                if let Ok(Line::Record(time)) = plan.read(line, &mut record) {
                    prop_assert!(time.is_some());
                }
            }
        }
    }
}
