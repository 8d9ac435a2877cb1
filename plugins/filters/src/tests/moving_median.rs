//! `moving_median`: spikes, edges, and the definition.

use super::*;

#[test]
fn the_median_removes_spikes_and_delays_an_edge_by_half_its_window() {
    let mut bench = Bench::<MovingMedian>::new(r#"{"window": 5}"#);
    let spikes = [10usize, 20, 21];
    let out = through(&mut bench, 100, |t| {
        let n = (t * 1e3).round() as usize;
        if spikes.contains(&n) { 1e6 } else { f64::from(u8::from(n >= 50)) }
    });
    assert!(out[..52].iter().all(|y| *y == 0.0), "spikes are gone, the edge is not there yet");
    assert!(out[52..].iter().all(|y| *y == 1.0), "it comes two samples later");
}

#[test]
fn the_median_is_the_one_of_a_sorted_window() {
    let mut random = fastrand::Rng::with_seed(3);
    let signal: Vec<f64> = (0..300).map(|_| random.f64()).collect();
    let mut bench = Bench::<MovingMedian>::new(r#"{"window": 9}"#);
    let out = through(&mut bench, 300, |t| signal[(t * 1e3).round() as usize]);
    for n in 8..300 {
        let mut window = signal[n - 8..=n].to_vec();
        window.sort_by(f64::total_cmp);
        assert_eq!(out[n], window[4]);
    }
    assert_eq!(
        refused::<MovingMedian>(r#"{"window": 4}"#),
        "window: 4 is even: an odd number of samples has a median"
    );
    assert_eq!(refused::<MovingMedian>(r#"{"window": 103}"#), "window: 103 is above 101");
}

#[test]
fn another_window_lets_no_spike_through() {
    let mut bench = Bench::<MovingMedian>::new(r#"{"window": 5}"#);
    through(&mut bench, 20, |_| 3.0);
    for window in [7, 5, 3, 101, 5] {
        bench.configure(format!(r#"{{"window": {window}}}"#)).unwrap();
        let out = through(&mut bench, 20, |t| if t == 0.0 { 1e6 } else { 3.0 });
        assert_eq!(out, [3.0; 20], "{window}");
    }
    bench.command::<(), ()>("clear", ()).unwrap();
    assert_eq!(through(&mut bench, 1, |_| 8.0), [8.0], "the first one after clear");
}
