//! Behaviour of a process while its GCM hangs.
#![allow(clippy::unwrap_used)]

use tokio::io::AsyncReadExt;
use tokio::net::TcpListener;

use super::*;
use crate::gcm::fake::{FakeLcm, comes, name};

#[tokio::test]
async fn a_gcm_that_hangs_finds_no_hello_of_an_attempt_that_was_given_up() {
    let hung = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let addr = hung.local_addr().unwrap().to_string();
    let who = Registration::new(name("left-behind"), "127.0.0.1:7".into());
    let refused = Uplink::start(
        addr.clone(),
        crate::control::Dialler::local(),
        who,
        FakeLcm::new("left-behind"),
        Begin::AtOnce,
    )
    .await;
    let refused = refused.map(|_| ()).unwrap_err();
    let within = format!("it did not answer within {} s", ATTEMPT.as_secs());
    assert_eq!(refused, UplinkError::NoGcm { addr, because: within });
    let (mut stream, _) = hung.accept().await.unwrap();
    let mut said = Vec::new();
    comes("an attempt that was given up is closed", stream.read_to_end(&mut said)).await.unwrap();
    assert!(!said.is_empty(), "nobody was asked whether it lives");
    let hello = said.windows(11).any(|bytes| bytes == b"left-behind");
    assert!(!hello, "it would take in, when it goes on, a process that has gone elsewhere");
}

#[test]
fn however_long_a_gcm_was_away_it_is_dialed_several_times_a_second() {
    let mut pauses = std::iter::successors(Some(PAUSE.0), |pause| Some(longer(*pause)));
    assert!(pauses.by_ref().take(1000).all(|pause| pause <= Duration::from_millis(200)));
    assert!(pauses.next().unwrap() >= Duration::from_millis(100), "what is away for good costs little");
}
