//! The display on the bench: what it counts, what a browser sees, and what it refuses.
#![allow(clippy::unwrap_used)]

use super::*;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;
use trocar_sdk::data::PixelFormat;
use trocar_sdk::testing::Bench;

use crate::watchdog::Watchdog;

trocar_sdk::testing::count_allocations!();

/// Two images of `width` × 16 px.
fn header(index: u64, width: u32) -> StereoHeader {
    let stride = 3 * width;
    let right_offset = u64::from(stride) * 16;
    StereoHeader {
        index,
        width,
        height: 16,
        stride,
        format: PixelFormat::RGB8,
        right_offset,
        ..Default::default()
    }
}

/// Left red, right blue.
fn pixels(width: usize) -> Vec<u8> {
    [[200, 0, 0].repeat(16 * width), [0, 0, 200].repeat(16 * width)].concat()
}

fn show(bench: &mut Bench<Display>, index: u64) {
    bench.push_frame("image", header(index, 16), &pixels(16));
    bench.step(1);
}

/// A request to a display, and its connection.
fn ask(bench: &Bench<Display>, request: &str) -> TcpStream {
    let mut connection = TcpStream::connect(("127.0.0.1", bench.state().mjpeg_port as u16)).unwrap();
    connection.write_all(request.as_bytes()).unwrap();
    connection.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    connection
}

fn get(bench: &Bench<Display>, path: &str) -> TcpStream {
    ask(bench, &format!("GET {path} HTTP/1.1\r\nHost: localhost:1\r\n\r\n"))
}

fn answer(mut connection: TcpStream) -> String {
    let mut text = String::new();
    connection.read_to_string(&mut text).unwrap();
    text
}

/// Shows frames until somebody else's thread has the answer.
fn shows_until<T>(bench: &mut Bench<Display>, mut done: impl FnMut(&mut Bench<Display>) -> Option<T>) -> T {
    let mut watchdog = Watchdog::of("another thread's answer");
    for index in 0.. {
        show(bench, index);
        if let Some(done) = done(bench) {
            return done;
        }
        let (viewers, pictures) = (bench.state().viewers, bench.state().pictures);
        watchdog.saw(format_args!("{viewers} viewers, {pictures} pictures"));
        std::thread::yield_now();
    }
    unreachable!()
}

/// The first picture of a stream: what was said before it, width, height, colours left and right of its
/// middle, and in its corner.
type Picture = (String, u32, u32, [[u8; 3]; 2], [u8; 3]);

fn first_picture(bench: &mut Bench<Display>, path: &str) -> Picture {
    let connection = get(bench, path);
    let reader = std::thread::spawn(move || picture_of(connection));
    shows_until(bench, |_| reader.is_finished().then_some(()));
    reader.join().unwrap()
}

fn picture_of(mut connection: TcpStream) -> Picture {
    let head = head_of(&mut connection);
    let picture = next_image(&mut connection);
    let (width, height) = picture.dimensions();
    let at = |x| picture.get_pixel(x, height / 2).0;
    (head, width, height, [at(width / 4), at(3 * width / 4)], picture.get_pixel(0, 0).0)
}

/// The colour of the corner of the next picture.
fn next_picture(connection: &mut TcpStream) -> [u8; 3] {
    next_image(connection).get_pixel(0, 0).0
}

/// The lines before an empty line.
fn head_of(connection: &mut TcpStream) -> String {
    let (mut text, mut byte) = (String::new(), [0]);
    while !text.ends_with("\r\n\r\n") {
        connection.read_exact(&mut byte).unwrap_or_else(|why| panic!("{why} after {text}"));
        text.push(byte[0].into());
    }
    text
}

fn next_image(connection: &mut TcpStream) -> image::RgbImage {
    // That of the answer itself is over already.
    let part = loop {
        let head = head_of(connection);
        if head.contains("Content-Length: ") {
            break head;
        }
    };
    let length = part.split("Content-Length: ").nth(1).unwrap().trim().parse::<usize>().unwrap();
    let mut bytes = vec![0; length];
    connection.read_exact(&mut bytes).unwrap();
    image::load_from_memory(&bytes).unwrap().to_rgb8()
}

#[test]
fn it_counts_frames_and_knows_their_age() {
    let mut bench = Bench::<Display>::new("{}");
    bench.push_frame("image", header(1, 2), &[0; 192]);
    bench.advance(4_000_000);
    bench.step(1);
    let s = bench.state();
    assert_eq!((s.frames, s.gaps, s.width, s.height), (1, 0, 2, 16));
    // 4 ms, and the bench's step of 1 ms.
    assert!((s.latency_ms - 5.0).abs() < 1e-9, "{} ms", s.latency_ms);
    assert_eq!(bench.read::<(), u64>("frames", ()).unwrap(), 1);
}

#[test]
fn it_counts_what_was_overwritten_before_it_was_shown() {
    let mut bench = Bench::<Display>::new("{}");
    for index in 0..4 {
        bench.push_frame("image", header(index, 1), &[0; 96]);
        if index != 1 && index != 2 {
            bench.step(1);
        }
    }
    assert_eq!((bench.state().frames, bench.state().gaps), (2, 2));
}

#[test]
fn it_tells_percentiles_of_the_ages_until_it_is_told_to_forget_them() {
    let mut bench = Bench::<Display>::new("{}");
    for n in 0..100 {
        bench.push_frame("image", header(n, 1), &[0; 96]);
        bench.advance(if n == 50 { 40_000_000 } else { 3_000_000 });
        bench.step(1);
    }
    let told: Latency = bench.read("latency", ()).unwrap();
    assert_eq!(told.frames, 100);
    assert!((told.p50_ms - 4.0).abs() < 0.15 && (told.p99_ms - 4.0).abs() < 0.15, "{told:?}");
    assert!((told.max_ms - 41.0).abs() < 1e-6, "{told:?}");
    bench.command::<(), ()>("reset_latency", ()).unwrap();
    assert_eq!(bench.read::<(), Latency>("latency", ()).unwrap(), Latency::default());
}

#[test]
fn a_browser_sees_both_eyes_or_one_of_them() {
    let mut bench = Bench::<Display>::new(r#"{"mjpeg_port": 0, "name": "theatre-1", "mjpeg_hz": 240}"#);
    let near = |a: [u8; 3], b: [u8; 3]| a.iter().zip(b).all(|(a, b)| a.abs_diff(b) < 30);
    let (red, blue) = ([200, 0, 0], [0, 0, 200]);
    for (path, width, colours) in [
        ("/stream/theatre-1", 32, [red, blue]),
        ("/stream/theatre-1/both?now", 32, [red, blue]),
        ("/stream/theatre-1/left", 16, [red, red]),
        ("/stream/theatre-1/right", 16, [blue, blue]),
    ] {
        let (head, w, h, seen, _) = first_picture(&mut bench, path);
        assert!(head.starts_with("HTTP/1.1 200 OK"), "{head}");
        assert!(head.contains("multipart/x-mixed-replace; boundary=trocar-frame"), "{head}");
        assert_eq!((w, h), (width, 16), "{path}");
        assert!(near(seen[0], colours[0]) && near(seen[1], colours[1]), "{path}: {seen:?}");
    }
    shows_until(&mut bench, |bench| (bench.state().viewers == 0).then_some(()));
    assert!(bench.state().pictures >= 4);
    let list = answer(get(&bench, "/"));
    assert!(list.contains("href=\"/stream/theatre-1/left\""), "{list}");
}

#[test]
fn who_comes_late_sees_the_last_frame_though_no_other_ever_comes() {
    let mut bench = Bench::<Display>::new(r#"{"mjpeg_port": 0}"#);
    for index in 0..5 {
        show(&mut bench, index);
    }
    // The last one is green.
    bench.push_frame("image", header(5, 16), &[0, 200, 0].repeat(2 * 16 * 16));
    bench.step(1);
    for path in ["/stream/display/left", "/stream/display/right", "/stream/display/left"] {
        let seen = picture_of(get(&bench, path)).3;
        assert!(seen[0][1] > 150 && seen[0][0] < 60 && seen[0][2] < 60, "{path}: {seen:?}");
    }
}

/// Asks until the corner of the first picture is as it shall be.
fn corner(bench: &mut Bench<Display>, path: &str, done: impl Fn([u8; 3]) -> bool) {
    let mut watchdog = Watchdog::of(format!("the corner of {path} is as it shall be"));
    loop {
        let seen = picture_of(get(bench, path)).4;
        if done(seen) {
            return;
        }
        watchdog.saw(format_args!("{seen:?}"));
    }
}

#[test]
fn a_frozen_picture_is_marked_for_who_looks_and_who_comes_and_the_next_one_is_not() {
    let mut bench = Bench::<Display>::new(r#"{"mjpeg_port": 0, "mjpeg_hz": 0.1}"#);
    let green = [0, 200, 0].repeat(2 * 64 * 16);
    let show = |bench: &mut Bench<Display>| {
        let stamp = bench.now();
        bench.push_frame("image", StereoHeader { stamp, ..header(1, 64) }, &green);
        bench.step(1);
    };
    let (red, clear) = (|c: [u8; 3]| c[0] > 180 && c[1] < 80, |c: [u8; 3]| c[0] < 80 && c[1] > 150);
    show(&mut bench);
    corner(&mut bench, "/stream/display/left", clear);
    // Somebody looks already; no step runs while nothing comes.
    let mut looking = get(&bench, "/stream/display/left");
    head_of(&mut looking);
    let first = next_picture(&mut looking);
    assert!(clear(first), "{first:?}");
    bench.advance(400_000_000);
    corner(&mut bench, "/stream/display/right", clear);
    bench.advance(300_000_000);
    let frozen = next_picture(&mut looking);
    assert!(red(frozen), "{frozen:?}");
    corner(&mut bench, "/stream/display", red);
    assert_eq!(bench.state().stalls, 0, "it is not over");
    show(&mut bench);
    let again = next_picture(&mut looking);
    assert!(clear(again), "{again:?}");
    assert_eq!(bench.state().stalls, 1);
    // A camera whose clock is a minute ahead, and that falls silent, is silent.
    let ahead = Stamp::from_ns(bench.now().ns() + 60_000_000_000);
    bench.push_frame("image", StereoHeader { stamp: ahead, ..header(1, 64) }, &green);
    bench.step(1);
    corner(&mut bench, "/stream/display/left", clear);
    bench.advance(700_000_000);
    corner(&mut bench, "/stream/display/left", red);
    show(&mut bench);
    assert_eq!(bench.state().stalls, 2);
    // A frame that never becomes stale is never marked.
    bench.configure(r#"{"mjpeg_port": 0, "mjpeg_hz": 0.1, "stale_after_s": 0}"#).unwrap();
    bench.advance(90_000_000_000);
    corner(&mut bench, "/stream/display/left", clear);
}

#[test]
fn while_nobody_looks_a_large_video_is_copied_a_few_times_a_second_only() {
    let mut allowance = Allowance::default();
    let mut copied = 0;
    // A pair of 1024 × 768 px at 30 Hz for 10 s.
    for n in 1..=300u64 {
        copied += u64::from(allowance.takes(2 * 3 * 1024 * 768, Stamp::from_ns(n * 33_333_333)));
    }
    assert!((30..=36).contains(&copied), "{copied}");
    // A B-scan of 0.4 MB, ten times a second, is copied each time, and two at once, too.
    let mut allowance = Allowance::default();
    assert!((1..=100u64).all(|n| allowance.takes(400_000, Stamp::from_ns(n * 100_000_000))));
    assert!(allowance.takes(400_000, Stamp::from_ns(10_000_000_001)));
}

#[test]
fn single_images_are_shown_and_counted_as_pairs_are() {
    let mut bench = Bench::<Display>::new(r#"{"mjpeg_port": 0}"#);
    let picture =
        ImageHeader { width: 16, height: 16, stride: 16, format: PixelFormat::GRAY8, ..Default::default() };
    let reader = {
        let mut connection = get(&bench, "/stream/display");
        std::thread::spawn(move || {
            let mut bytes = vec![0; 900];
            connection.read_exact(&mut bytes).unwrap();
            String::from_utf8_lossy(&bytes).into_owned()
        })
    };
    let mut watchdog = Watchdog::of("the reader has its picture");
    while !reader.is_finished() {
        bench.push_frame("picture", picture, &[90; 256]);
        bench.step(1);
        watchdog.saw(bench.state().pictures);
        std::thread::yield_now();
    }
    assert!(reader.join().unwrap().contains("Content-Type: image/jpeg"));
    let s = bench.state();
    assert_eq!((s.width, s.height, s.gaps), (16, 16, 0));
    assert_eq!(s.frames, s.latency.frames);
}

#[test]
fn while_nobody_looks_no_picture_is_made_and_a_step_allocates_nothing() {
    let mut bench = Bench::<Display>::new(r#"{"mjpeg_port": 0}"#);
    for index in 0..50 {
        show(&mut bench, index);
    }
    assert_eq!((bench.state().pictures, bench.state().viewers), (0, 0));
    let _viewer = get(&bench, "/stream/display");
    shows_until(&mut bench, |bench| (bench.state().viewers == 1).then_some(()));
    bench.assert_no_alloc(|bench| (0..200).for_each(|index| show(bench, index)));
}

#[test]
fn a_viewer_that_takes_nothing_holds_up_neither_the_step_nor_another_viewer_and_is_left() {
    let mut bench = Bench::<Display>::new(r#"{"mjpeg_port": 0, "mjpeg_hz": 240, "mjpeg_quality": 100}"#);
    let stuck = get(&bench, "/stream/display/both");
    shows_until(&mut bench, |bench| (bench.state().viewers == 1).then_some(()));
    // Noise makes large pictures, which soon fill what the system keeps for the stuck one.
    let mut random = 1u32;
    let noise: Vec<u8> = std::iter::repeat_with(|| {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (random >> 24) as u8
    })
    .take(2 * 3 * 512 * 16)
    .collect();
    let mut watchdog = Watchdog::of("the stuck viewer is left");
    let mut shown = bench.state().frames;
    while bench.state().viewers > 0 {
        bench.push_frame("image", header(shown, 512), &noise);
        bench.step(1);
        shown += 1;
        assert_eq!((bench.state().frames, bench.state().gaps), (shown, 0));
        watchdog.saw(bench.state().pictures);
        std::thread::yield_now();
    }
    first_picture(&mut bench, "/stream/display/left");
    drop(stuck);
}

#[test]
fn displays_share_a_port_and_each_name_is_there_once() {
    let first = Bench::<Display>::new(r#"{"mjpeg_port": 0, "name": "a"}"#);
    let port = first.state().mjpeg_port;
    let other = |name: &str| {
        let mut bench = Bench::<Display>::ready(format!(r#"{{"mjpeg_port": {port}, "name": "{name}"}}"#));
        bench.start().map(|()| bench).map_err(|why| why.reason)
    };
    let second = other("b").unwrap();
    assert_eq!(second.state().mjpeg_port, port);
    let why = other("a").err().unwrap();
    assert_eq!(why, format!("name: another display at port {port} is called a; choose another name"));
    let list = answer(get(&first, "/"));
    assert!(list.contains("/stream/a") && list.contains("/stream/b"), "{list}");
    drop(second);
    assert!(!answer(get(&first, "/")).contains("/stream/b"));
    assert!(other("b").is_ok(), "its name is free again");
}

#[test]
fn a_port_that_somebody_else_keeps_is_waited_for_and_then_told_and_frames_are_counted_all_the_same() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let mut bench = Bench::<Display>::ready(format!(r#"{{"mjpeg_port": {port}}}"#));
    bench.start().unwrap();
    assert_eq!((bench.state().mjpeg, bench.state().mjpeg_port), (Serving::WAITING, 0));
    shows_until(&mut bench, |bench| (bench.state().mjpeg == Serving::REFUSED).then_some(()));
    let counted = bench.state().frames;
    (0..10).for_each(|index| show(&mut bench, 1_000_000 + index));
    assert_eq!((bench.state().frames, bench.state().mjpeg_port), (counted + 10, 0));
    assert_eq!(bench.life(), trocar_sdk::testing::Life::Active);
    assert_eq!(bench.events::<u32>("screen/mjpeg_refused"), [u32::from(port)], "once");
    // Another Start tries anew.
    bench.stop().unwrap();
    drop(taken);
    bench.start().unwrap();
    assert_eq!((bench.state().mjpeg, bench.state().mjpeg_port), (Serving::LISTENING, port.into()));
}

#[test]
fn what_is_not_there_and_what_is_not_asked_properly_is_answered_with_what_to_do() {
    let bench = Bench::<Display>::new(r#"{"mjpeg_port": 0}"#);
    let missing = answer(get(&bench, "/stream/other"));
    assert!(missing.starts_with("HTTP/1.1 404") && missing.contains("there is /stream/display"), "{missing}");
    assert!(answer(get(&bench, "/stream/display/middle")).starts_with("HTTP/1.1 404"));
    assert!(answer(get(&bench, "/etc/passwd")).contains("there is / and /stream/NAME"));
    let post = answer(ask(&bench, "POST / HTTP/1.1\r\nHost: localhost\r\n\r\n"));
    assert!(post.starts_with("HTTP/1.1 405"), "{post}");
    let foreign = answer(ask(&bench, "GET / HTTP/1.1\r\nHost: evil.example:80\r\n\r\n"));
    assert!(foreign.starts_with("HTTP/1.1 403"), "{foreign}");
    for own in ["127.0.0.1:9", "[::1]:9", "localhost"] {
        let answered = answer(ask(&bench, &format!("GET / HTTP/1.1\r\nHost: {own}\r\n\r\n")));
        assert!(answered.starts_with("HTTP/1.1 200"), "{answered}");
    }
    assert!(answer(ask(&bench, "nonsense\r\n\r\n")).starts_with("HTTP/1.1 400"));
    let endless = format!("GET /{} HTTP/1.1\r\n", "x".repeat((8 << 10) - 16));
    assert!(answer(ask(&bench, &endless)).starts_with("HTTP/1.1 400"));
}

#[test]
fn a_stopped_display_ends_its_streams_and_a_resumed_one_shows_again() {
    let mut bench = Bench::<Display>::new(r#"{"mjpeg_port": 0}"#);
    let mut viewer = get(&bench, "/stream/display");
    shows_until(&mut bench, |bench| (bench.state().viewers == 1).then_some(()));
    bench.stop().unwrap();
    assert_eq!(bench.state().mjpeg_port, 0);
    viewer.read_to_end(&mut Vec::new()).unwrap();
    bench.resume().unwrap();
    assert!(answer(get(&bench, "/")).contains("/stream/display"));
}

#[test]
fn frames_that_are_larger_than_was_said_or_lie_are_counted_and_not_shown() {
    let mut bench = Bench::<Display>::new(r#"{"mjpeg_port": 0, "max_width": 8, "max_height": 8}"#);
    let viewer = get(&bench, "/stream/display");
    shows_until(&mut bench, |bench| (bench.state().viewers == 1).then_some(()));
    for index in 0..20 {
        show(&mut bench, index);
        bench.push_frame("image", StereoHeader { width: 999, ..header(index, 2) }, &[0; 192]);
        bench.step(1);
    }
    assert_eq!((bench.state().gaps, bench.state().pictures), (0, 0));
    drop(viewer);
}

#[test]
fn a_window_without_a_display_is_refused_with_what_is_missing() {
    let mut bench = Bench::<Display>::ready(r#"{"window": true}"#);
    match bench.start() {
        Err(why) => {
            assert!(why.reason.starts_with("window: ") && why.reason.contains("use mjpeg_port"), "{why}")
        }
        // A machine with a display has a window.
        Ok(()) => assert!(bench.state().window_open.get()),
    }
}

#[test]
fn settings_that_make_no_sense_are_refused() {
    let refused = |config: &str| Bench::<Display>::created().configure(config).unwrap_err().reason;
    assert!(refused(r#"{"name": "a/b"}"#).starts_with("name: \"a/b\" has other than"));
    assert_eq!(refused(r#"{"mjpeg_port": 70000}"#), "mjpeg_port: 70000 is not a whole number that fits");
    assert_eq!(refused(r#"{"mjpeg_quality": 0}"#), "mjpeg_quality: 0 % is below 1 %");
}
