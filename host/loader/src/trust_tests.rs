//! Decisions of each trust mode, as pure functions; reading of allow lists.
#![allow(clippy::unwrap_used)]

use super::*;

const OWN: u32 = 1000;

fn file(uid: u32, mode: u32) -> Ownership {
    Ownership { uid, mode, own_uid: OWN }
}

fn strict() -> Trust {
    Trust::AllowList(AllowList::new("list.json", []))
}

#[test]
fn both_modes_take_own_and_root_files() {
    for trust in [Trust::Dev, strict()] {
        assert_eq!(trust.judge_owner(file(OWN, 0o755)), Ok(vec![]));
        assert_eq!(trust.judge_owner(file(0, 0o555)), Ok(vec![]));
    }
}

#[test]
fn both_modes_refuse_foreign_and_world_writable_files() {
    for trust in [Trust::Dev, strict()] {
        let foreign = trust.judge_owner(file(65534, 0o755)).unwrap_err();
        assert_eq!(foreign, Fault::ForeignOwner { owner: 65534, own: OWN });
        let open = trust.judge_owner(file(OWN, 0o757)).unwrap_err();
        assert!(open.to_string().contains("mode 757"), "{open}");
    }
}

#[test]
fn a_group_writable_file_is_a_warning_in_dev_and_a_refusal_in_strict_mode() {
    assert_eq!(Trust::Dev.judge_owner(file(OWN, 0o775)).unwrap().len(), 1);
    assert_eq!(strict().judge_owner(file(OWN, 0o775)), Err(Fault::GroupWritable { mode: 0o775 }));
}

#[test]
fn a_hash_outside_the_allow_list_is_refused_and_named() {
    let (listed, other) = (Hash::of(b"a"), Hash::of(b"b"));
    let trust = Trust::AllowList(AllowList::new("list.json", [listed]));
    assert_eq!(trust.judge_hash(&listed), Ok(()));
    let fault = trust.judge_hash(&other).unwrap_err();
    assert!(fault.to_string().contains(&other.to_string()), "{fault}");
    assert_eq!(fault.reason(), "PLUGIN_UNTRUSTED");
}

#[test]
fn an_allow_list_is_read_from_json_and_its_mistakes_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("list.json");
    let mode = format!("allowlist:{}", path.display());
    let hash = Hash::of(b"x");
    write_private(&path, &format!("{{\"sha256\": [\"{hash}\"]}}"));
    assert!(mode.parse::<Trust>().unwrap().judge_hash(&hash).is_ok());
    for (text, said) in
        [("{\"sha256\": [\"12\"]}", "entry 0"), ("{", "EOF"), ("{\"md5\": []}", "unknown field")]
    {
        write_private(&path, text);
        let error = mode.parse::<Trust>().unwrap_err().to_string();
        assert!(error.contains(said), "{text}: {error}");
    }
}

#[test]
fn unknown_and_later_trust_modes_are_refused_with_what_exists() {
    assert_eq!("signed".parse::<Trust>(), Err(StoreError::TrustSigned));
    let error = "paranoid".parse::<Trust>().unwrap_err().to_string();
    assert!(error.contains("allowlist:FILE"), "{error}");
}

fn write_private(path: &Path, text: &str) {
    use std::os::unix::fs::PermissionsExt;
    std::fs::write(path, text).unwrap();
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600)).unwrap();
}
