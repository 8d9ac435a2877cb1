//! Meaning of the words and the end of a child, without a child.

use super::*;

const LIMIT: Duration = Duration::from_secs(5);

fn verdict(text: &str, raw_status: Option<i32>) -> Result<(), Fault> {
    Report::parse(text).verdict(raw_status.map(ExitStatus::from_raw), LIMIT, "no licence")
}

#[test]
fn only_a_clean_end_after_ok_is_a_good_verdict() {
    assert_eq!(verdict("trocar-vet loading\ntrocar-vet ok\n", Some(0)), Ok(()));
    assert!(verdict("trocar-vet ok\n", Some(libc::SIGSEGV)).is_err());
    assert!(verdict("ok\n", Some(0)).is_err());
    assert!(verdict("", Some(0)).is_err());
}

#[test]
fn the_last_stage_tells_where_it_crashed_or_hung() {
    let crash = verdict("trocar-vet loading\ntrocar-vet layout\ntrocar-vet entry\n", Some(libc::SIGABRT));
    assert!(crash.as_ref().is_err_and(|e| e.to_string().contains(r#", saying "no licence";"#)), "{crash:?}");
    assert!(matches!(crash, Err(Fault::Crashed { during: Stage::Entry, .. })), "{crash:?}");
    let hung = verdict("trocar-vet loading\n", None);
    assert_eq!(hung, Err(Fault::Hung { during: Stage::Loading, seconds: 5, said: "no licence".into() }));
}

#[test]
fn a_reported_fault_counts_whatever_else_was_printed() {
    let text =
        "running 1 test\ntrocar-vet loading\nnoise\ntrocar-vet {\"undefined_symbol\":{\"symbol\":\"f\"}}\n";
    assert_eq!(verdict(text, Some(1 << 8)), Err(Fault::UndefinedSymbol { symbol: "f".into() }));
}
