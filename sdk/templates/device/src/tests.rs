//! The sensor on the bench, with a device that the test plays over TCP.

use super::reader::value_of;
use super::*;
use std::io::Write;
use std::net::{TcpListener, TcpStream};
use trocar_sdk::testing::Bench;

trocar_sdk::testing::count_allocations!();

fn device() -> (TcpListener, Bench<{{Name}}>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let bench = Bench::new(json!({ "address": address.to_string() }).to_string());
    (listener, bench)
}

/// Sends a line, and steps until its value comes out; the bench's clock stands still meanwhile.
fn measured(bench: &mut Bench<{{Name}}>, device: &mut TcpStream, line: &str) -> Scalar {
    device.write_all(line.as_bytes()).unwrap();
    loop {
        bench.step_after(0).unwrap();
        if let Some(value) = bench.outputs::<Scalar>("value").last() {
            return *value;
        }
        std::thread::yield_now();
    }
}

#[test]
fn values_come_and_the_silence_after_them_is_told_once() {
    let (listener, mut bench) = device();
    let (mut line, _) = listener.accept().unwrap();
    let value = measured(&mut bench, &mut line, "not a number\n0.25\n");
    assert!(value.value == 0.25 && value.stamp.is_valid(), "{value:?}");
    bench.step(100);
    let silent: Scalar = bench.read("latest", ()).unwrap();
    assert_eq!((silent.value, silent.stamp), (0.25, Stamp::INVALID));
    let [on, off] = [true, false].map(Flag::from);
    assert_eq!(bench.events::<Flag>("answers"), [on, off]);
}

#[test]
fn a_lost_device_is_opened_again() {
    let (listener, mut bench) = device();
    let (mut line, _) = listener.accept().unwrap();
    measured(&mut bench, &mut line, "1\n");
    drop(line);
    let (mut line, _) = listener.accept().unwrap();
    assert_eq!(measured(&mut bench, &mut line, "2\n").value, 2.0);
}

#[test]
fn a_step_allocates_nothing_and_stop_ends_the_thread() {
    let (listener, mut bench) = device();
    let (mut line, _) = listener.accept().unwrap();
    line.write_all(b"1\n2\n3\n").unwrap();
    bench.assert_no_alloc(|bench| bench.step(100));
    bench.stop().unwrap();
    let mut rest = Vec::new();
    // The other end is closed: there is nothing to wait for.
    let _ended = std::io::Read::read_to_end(&mut line, &mut rest);
    assert!(rest.is_empty());
}

#[test]
fn a_line_is_a_finite_number_or_nothing() {
    assert_eq!(value_of(b" -1.5e-3\r\n"), Some(-1.5e-3));
    for nothing in [&b"\n"[..], b"1,5\n", b"inf\n", b"\xff\n"] {
        assert_eq!(value_of(nothing), None);
    }
}
