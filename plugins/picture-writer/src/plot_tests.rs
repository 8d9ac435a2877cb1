//! Numbers of several types in, real files out.

use super::*;
use trocar_sdk::data::{Distance, ImageHeader, Scalar};
use trocar_sdk::testing::Bench;

const TWO: &str = r#"{"fields": ["", "distance"], "valid": ["", "valid"], "scales": [1.0, 1e6],
                      "offsets": [0.0, 0.0005], "labels": ["error", "true / um"], "title": "offset"}"#;

fn save(bench: &mut Bench<Plot>, path: &std::path::Path) -> Result<SavedPicture, String> {
    let path = Text::new(path.to_str().unwrap());
    bench.command("ctl/save", SaveRequest { path }).map_err(|why| why.to_string())
}

fn distance(distance: f64, valid: bool) -> Distance {
    Distance { distance, valid: valid.into(), ..Distance::default() }
}

#[test]
fn numbers_of_several_types_are_drawn_to_a_file() {
    let dir = tempfile::tempdir().unwrap();
    let mut bench = Bench::<Plot>::new(TWO);
    for n in 0..500 {
        bench.push("a", f64::from(n % 7));
        bench.push("b", distance(5e-4 + 1e-6 * f64::from(n % 3), n % 50 != 0));
        bench.advance(1_000_000);
        bench.step(1);
    }
    assert_eq!((bench.state().samples, bench.state().rejected), (1_000, 0));
    let path = dir.path().join("plot.png");
    let saved = save(&mut bench, &path).unwrap();
    assert_eq!((saved.width, saved.height), (1_200, 600));
    // The bench's own millisecond after the one before the last step.
    assert!((saved.age - 2e-3).abs() < 1e-9, "{} s", saved.age);
    assert_eq!(saved.bytes, path.metadata().unwrap().len());
    let why = save(&mut bench, &path).unwrap_err();
    assert!(why.contains("nothing is written over"), "{why}");
    bench.command::<(), ()>("ctl/clear", ()).unwrap();
    let why = save(&mut bench, &dir.path().join("b.png")).unwrap_err();
    assert!(why.contains("no number has come yet: connect `a`, `b`, `c` or `d`"), "{why}");
}

fn series(values: &[(u64, f64)]) -> Series {
    let mut trace = Trace::new(8);
    for (at_ns, value) in values {
        assert!(trace.push(Point { at_ns: *at_ns, value: *value }));
    }
    Series { trace, ..Series::default() }
}

#[test]
fn offsets_and_scales_are_applied_and_time_begins_with_the_first_point() {
    let cfg = PlotConfig { offsets: vec![0.0005, 0.0], scales: vec![1e6, 2.0], ..PlotConfig::unset() };
    let traces = [series(&[(2_000_000_000, 5.03e-4)]), series(&[(2_500_000_000, 4.0), (3_000_000_000, 5.0)])];
    let chart = chart_of(&cfg, &traces).unwrap();
    let (first, second) = (&chart.curves[0], &chart.curves[1]);
    assert_eq!((first.label.as_str(), second.label.as_str()), ("a", "b"));
    assert!(first.points[0].0 == 0.0 && (first.points[0].1 - 3.0).abs() < 1e-9);
    assert_eq!(second.points, [(0.5, 8.0), (1.0, 10.0)]);
    let labels = vec!["x / um".into(), "y".into()];
    let last = chart_of(&PlotConfig { window_s: 0.6, labels, ..cfg }, &traces).unwrap();
    assert_eq!(last.curves[0].label, "x / um");
    assert_eq!(
        (last.curves[0].points.len(), &last.curves[1].points[..]),
        (0, &[(0.0, 8.0), (0.5, 10.0)][..])
    );
}

#[test]
fn a_number_that_is_not_valid_is_a_gap() {
    let ty = trocar_sdk::AnyType::of_port(
        r#"{"plain": {"ref": "D"}, "types": [{"name": "D", "size": 16, "fields": [
            {"name": "d", "at": 0, "type": "f64"}, {"name": "valid", "at": 8, "type": "bool"}]}]}"#,
    );
    let ty = ty.unwrap();
    let of = Series { place: ty.place("d"), valid: ty.place("valid"), ..Series::default() };
    let sample = |valid: u8| [&2.5f64.to_le_bytes()[..], &[valid], &[0; 7]].concat();
    assert_eq!(of.read(&sample(1)), Some(2.5));
    assert!(of.read(&sample(0)).is_some_and(f64::is_nan));
    assert_eq!(of.read(&[0; 3]), None);
}

#[test]
fn what_has_no_number_there_is_counted_and_told_once() {
    let mut bench = Bench::<Plot>::new(r#"{"fields": ["nothing"]}"#);
    for _ in 0..3 {
        bench.push("a", Scalar { stamp: bench.now(), value: 1.0 });
        bench.advance(1_000);
        bench.step(1);
    }
    assert_eq!((bench.state().samples, bench.state().rejected), (0, 3));
    let told = bench.events::<Text<160>>("ctl/unplaced");
    assert_eq!(told, ["a: there is no number at \"nothing\" in what is connected; set `fields`"], "once");
    let dir = tempfile::tempdir().unwrap();
    let why = save(&mut bench, &dir.path().join("plot.png")).unwrap_err();
    assert!(why.contains("there is no number at \"nothing\""), "{why}");
    // Another place, set while it runs, is looked for anew.
    bench.stop().unwrap();
    bench.configure(r#"{"fields": ["value"]}"#).unwrap();
    bench.start().unwrap();
    bench.push("a", Scalar { stamp: bench.now(), value: 1.0 });
    bench.step(1);
    assert_eq!((bench.state().samples, bench.state().rejected), (1, 0));
}

#[test]
fn no_step_allocates_not_the_first_of_a_connection_either() {
    let mut bench = Bench::<Plot>::new(r#"{"fields": ["distance", "none"], "valid": ["valid", "none"]}"#);
    bench.assert_no_alloc(|bench| {
        for n in 0..4 {
            bench.push("a", distance(1e-3, true));
            bench.push("b", Scalar { stamp: bench.now(), value: f64::from(n) });
            bench.advance(1_000);
            bench.step(1);
        }
    });
    assert_eq!((bench.state().samples, bench.state().rejected), (4, 4));
    assert_eq!(bench.events::<Text<160>>("ctl/unplaced").len(), 2, "no number and no flag");
}

#[test]
fn another_connection_may_bring_another_type_and_frames_have_numbers_in_their_headers() {
    let mut bench = Bench::<Plot>::new(r#"{"fields": ["width"]}"#);
    let header = ImageHeader { width: 640, ..ImageHeader::default() };
    bench.push_frame("a", header, &[]);
    bench.step(1);
    assert_eq!((bench.state().samples, bench.state().rejected), (1, 0));
    bench.advance(1_000);
    bench.push("a", 3.0f64);
    bench.step(1);
    assert_eq!((bench.state().samples, bench.state().rejected), (1, 1), "a number has no field");
}

#[test]
fn settings_that_cannot_be_are_refused_with_what_to_do() {
    for (config, part) in [
        (
            r#"{"fields": ["", "", "", "", "x"]}"#,
            "fields: 5 are too many: there are the inputs a, b, c and d",
        ),
        (r#"{"scales": [1, 2, 3, 4, 5]}"#, "scales: 5 are too many"),
        (r#"{"y_min": 2.0, "y_max": 1.0}"#, "y_min, y_max: 2 is not below 1"),
        (r#"{"keep": 1}"#, "keep: 1 is below 2"),
    ] {
        let why = Bench::<Plot>::created().configure(config).unwrap_err().to_string();
        assert!(why.contains(part), "{config}: {why}");
    }
}

#[test]
fn a_step_allocates_nothing_once_it_knows_its_types() {
    let mut bench = Bench::<Plot>::new(TWO);
    bench.push("a", 1.0);
    bench.push("b", distance(1e-3, true));
    bench.step(1);
    bench.advance(1_000);
    bench.assert_no_alloc(|bench| {
        bench.push("a", 2.0);
        bench.push("b", distance(2e-3, true));
        bench.step(1);
    });
    assert_eq!(bench.state().samples, 4);
}
