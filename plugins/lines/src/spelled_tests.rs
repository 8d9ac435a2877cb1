//! Samples as lines, and back.
#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use trocar_sdk::data::{JointState, OperatingMode, OperatingState, Pose};
use trocar_sdk::prelude::*;
use trocar_sdk::{AnyType, as_bytes};

use super::*;
use crate::plan::{Line, Plan};

const MIXED: &str = "mixed: a N, b f32 m, c i64, d u32, on bool, f[3] mm, n u64";

fn spelled<T: Payload>(name: &str, value: &T, format: Format) -> String {
    let ty = AnyType::of::<T>();
    let spelled = Spelled::of([(name, &ty, as_bytes(value))]);
    let mut text = String::new();
    spelled.header(&mut text);
    spelled.line(format, 1_500_000_000, &[as_bytes(value)], &mut text);
    text
}

#[test]
fn a_sample_is_a_row_under_a_header_with_units() {
    let pose = Pose { position: [0.001, -2.0, 1e300], ..Pose::default() };
    let text = spelled("tip", &pose, Format::Numbers);
    let (header, row) = text.split_once('\n').unwrap();
    assert!(
        header.starts_with("# t s, tip.position.0 m, tip.position.1 m, tip.position.2 m, tip.orientation.0,")
    );
    assert_eq!(row, "1.500000000,0.001,-2.0,1e300,0.0,0.0,0.0,1.0\n");
    let json = spelled("tip", &pose, Format::Json);
    assert!(
        json.contains(r#"{"t":1.500000000,"tip":{"#) && json.contains(r#""position":[0.001,-2.0,1e+300]"#),
        "{json}"
    );
}

#[test]
fn lists_have_the_columns_of_the_first_sample_and_words_are_one_cell() {
    let joints = JointState { position: List::of(&[1.0, 2.0]), ..JointState::default() };
    assert!(spelled("j", &joints, Format::Numbers).ends_with("\n1.500000000,1.0,2.0\n"));
    let state = OperatingState {
        state: OperatingMode::FAULT,
        message: Text::new("no, not\nso"),
        ..OperatingState::default()
    };
    assert!(spelled("s", &state, Format::Numbers).ends_with("\n1.500000000,FAULT,0,0,no__not_so\n"));
    let (ty, short) = (AnyType::of::<JointState>(), JointState { position: List::of(&[3.0]), ..joints });
    let spelled = Spelled::of([("j", &ty, as_bytes(&joints))]);
    let mut row = String::new();
    spelled.line(Format::Numbers, 0, &[as_bytes(&short)], &mut row);
    assert_eq!(row, "0.000000000,3.0,nan\n");
}

proptest! {
    #[test]
    fn what_is_written_is_read_back_with_the_same_digits(
        a in prop::num::f64::NORMAL | prop::num::f64::SUBNORMAL | prop::num::f64::ZERO,
        b in prop::num::f32::NORMAL | prop::num::f32::ZERO, c in any::<i64>(), d in any::<u32>(),
        on in any::<bool>(), f in any::<[i16; 3]>(), n in any::<u64>(), json in any::<bool>(), ns in 0u64..1 << 50,
    ) {
        let format = if json { Format::Json } else { Format::Numbers };
        let stamp = if json { "t s" } else { "1 s" };
        // Columns lie as the memory does: larger fields first.
        let text = if json { MIXED } else { "mixed: a N, c i64, f[3] mm, n u64, b f32 m, d u32, on bool" };
        let plan = Plan::of(&[text.to_owned()], format, stamp, 0).unwrap();
        let mut value = plan.blank.clone();
        let ty = &plan.outputs[0].ty;
        let numbers: Vec<f64> = f.iter().map(|n| f64::from(*n) * 0.1).collect();
        let words = [a.to_bits(), c.cast_unsigned(), numbers[0].to_bits(), numbers[1].to_bits(), numbers[2].to_bits(), n];
        for (i, word) in words.into_iter().enumerate() {
            value[8 + 8 * i..16 + 8 * i].copy_from_slice(&word.to_le_bytes());
        }
        value[56..60].copy_from_slice(&b.to_le_bytes());
        value[60..64].copy_from_slice(&d.to_le_bytes());
        value[64] = u8::from(on);
        let mut line = String::new();
        Spelled::of([("mixed", ty, &value[..])]).line(format, ns, &[&value], &mut line);
        let mut back = plan.blank.clone();
        let read = plan.read(line.trim_end().as_bytes(), &mut back);
        let Ok(Line::Record(Some(s))) = read else { panic!("{line}: {read:?}") };
        prop_assert_eq!((s * 1e9).round() as u64, ns);
        if json {
            // serde_json reads the last digit of an f64 as it likes; everything else is exact.
            for at in [8, 24, 32, 40] {
                let number = |bytes: &[u8]| f64::from_le_bytes(*bytes[at..].first_chunk().unwrap());
                let (wanted, got) = (number(&value), number(&back));
                prop_assert!((wanted - got).abs() <= 4.0 * f64::EPSILON * wanted.abs() + f64::MIN_POSITIVE, "{} {}", got, line);
                let exact: [u8; 8] = *value[at..].first_chunk().unwrap();
                back[at..at + 8].copy_from_slice(&exact);
            }
        }
        prop_assert_eq!(back, value, "{}", line);
    }
}
