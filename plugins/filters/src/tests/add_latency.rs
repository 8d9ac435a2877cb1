//! `add_latency`: order, delay, and what is too much.

use super::*;

#[test]
fn samples_leave_in_order_after_their_delay_with_their_stamps() {
    for jitter in ["0", "0.02"] {
        let config = format!(r#"{{"delay_s": 0.01, "jitter_s": {jitter}}}"#);
        let mut bench = Bench::<AddLatency>::new(config);
        bench.connect_as::<Scalar>("delayed");
        let (mut sent, mut left) = (Vec::new(), Vec::new());
        for n in 0..300 {
            if n < 200 {
                let stamp = bench.now();
                bench.push("sample", Scalar { stamp, value: f64::from(n) });
                sent.push(stamp);
            }
            bench.step(1);
            left.extend(bench.samples::<Scalar>("delayed").into_iter().map(|(s, at)| (s, at, bench.now())));
        }
        assert_eq!((left.len(), bench.state().rejected, bench.state().waiting), (200, 0, 0));
        for (n, (sample, stamp, when)) in left.iter().enumerate() {
            assert_eq!((sample.value, *stamp), (n as f64, sent[n]), "in order, with its stamp");
            let kept = when.seconds_since(sent[n]);
            let most = if jitter == "0" { 0.0121 } else { 0.0321 };
            assert!(kept >= 0.011 - 1e-9 && kept < most, "{kept} s");
        }
    }
}

#[test]
fn what_is_too_large_or_too_much_for_the_delay_line_is_counted() {
    let mut bench = Bench::<AddLatency>::new(r#"{"delay_s": 1, "depth": 3, "max_bytes": 16}"#);
    bench.connect_as::<Scalar>("delayed");
    for _ in 0..5 {
        bench.push("sample", scalar(1.0));
        bench.step(1);
    }
    assert_eq!((bench.state().waiting, bench.state().rejected), (3, 2));
    let mut bench = Bench::<AddLatency>::new(r#"{"max_bytes": 16}"#);
    bench.push("sample", Wrench::default());
    bench.step(1);
    assert_eq!(bench.state().rejected, 1);
    let why = refused::<AddLatency>(r#"{"depth": 65536, "max_bytes": 65536}"#);
    assert!(why.starts_with("depth, max_bytes: 65536 samples of 65536 B are more than 256 MiB"), "{why}");
}

#[test]
fn bad_numbers_are_delayed_as_good_ones_and_not_altered() {
    let mut bench = Bench::<AddLatency>::new(r#"{"delay_s": 0.002}"#);
    bench.connect_as::<Scalar>("delayed");
    let bad = [f64::NAN, f64::NEG_INFINITY, 1e308];
    for value in bad {
        bench.push("sample", scalar(value));
        bench.step(1);
    }
    bench.step(5);
    let out = bench.outputs::<Scalar>("delayed");
    assert_eq!(out.iter().map(|s| s.value.to_bits()).collect::<Vec<_>>(), bad.map(f64::to_bits));
}
