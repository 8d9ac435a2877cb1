//! Error buffers written by a plugin: the text, and the length it gives.

use trocar_plugin_api::abi::{ErrBuf, STATUS_FAILED, STATUS_PANICKED};

use super::super::entry::Unexplained;
use super::super::sentence;

#[test]
fn a_sentence_longer_than_its_buffer_ends_where_that_does_and_shows_no_padding() {
    let mut room = [0u8; 16];
    room[..7].copy_from_slice(b"too\x1bhot");
    let mut err = ErrBuf { ptr: room.as_mut_ptr(), cap: room.len(), len: 1 << 40 };
    assert_eq!(sentence(&raw mut err), "too\\u{1b}hot");
    err.len = 3;
    assert_eq!(sentence(&raw mut err), "too");
    assert_eq!(sentence(std::ptr::null_mut()), "");
}

#[test]
fn a_status_without_a_sentence_says_where_to_look_or_its_number() {
    for (status, words) in [
        (STATUS_PANICKED, "panicked (its words are in the log)"),
        (STATUS_FAILED, "status -1 without a reason"),
        (-99, "status -99 without a reason"),
        (7, "status 7, which this ABI does not have"),
    ] {
        assert_eq!(Unexplained(status).to_string(), words);
    }
}
