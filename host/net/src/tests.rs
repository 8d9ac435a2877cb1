//! Handshakes of both sides in memory, with certificates of real authorities.
#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{
    ClientConfig, ClientConnection, ConfigBuilder, Error, RootCertStore, ServerConnection, WantsVerifier,
};

use super::*;

struct Place {
    dir: tempfile::TempDir,
    authority: Authority,
}

pub(crate) fn wish(name: &str, role: Role) -> Wish {
    let processes = if role == Role::Host { vec![format!("{name}-*")] } else { Vec::new() };
    Wish {
        name: name.into(),
        role,
        processes,
        addresses: vec!["10.0.0.1".into(), "or1.local".into()],
        days: 30,
    }
}

impl Place {
    fn new() -> Place {
        let dir = tempfile::tempdir().unwrap();
        let authority = Authority::init(&dir.path().join("authority")).unwrap();
        Place { dir, authority }
    }

    fn at(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn issue(&mut self, name: &str, role: Role) -> Arc<Identity> {
        let out = self.at(name);
        self.authority.issue(&wish(name, role), &out).unwrap();
        Arc::new(Identity::read(&out).unwrap())
    }

    fn revoked(&self) -> Arc<Revoked> {
        Arc::new(Revoked::read(&self.authority.revoked_list()).unwrap())
    }
}

/// Moves what both sides have to say until they are done, or one of them ends it.
fn shake(
    client: &mut ClientConnection,
    server: &mut ServerConnection,
) -> (Result<(), Error>, Result<(), Error>) {
    let (mut of_client, mut of_server) = (Ok(()), Ok(()));
    for _ in 0..8 {
        let mut said = Vec::new();
        while client.wants_write() {
            client.write_tls(&mut said).unwrap();
        }
        let mut heard = said.as_slice();
        while !heard.is_empty() && of_server.is_ok() {
            server.read_tls(&mut heard).unwrap();
            of_server = server.process_new_packets().map(|_| ());
        }
        let mut said = Vec::new();
        while server.wants_write() {
            server.write_tls(&mut said).unwrap();
        }
        let mut heard = said.as_slice();
        while !heard.is_empty() && of_client.is_ok() {
            client.read_tls(&mut heard).unwrap();
            of_client = client.process_new_packets().map(|_| ());
        }
    }
    (of_client, of_server)
}

fn name() -> ServerName<'static> {
    ServerName::try_from("somewhere").unwrap()
}

/// The caller as the server takes it; else the words of each side.
fn meet(server: &Server, client: &Client) -> Result<Holder, (String, String)> {
    let mut client = ClientConnection::new(client.config(), name()).unwrap();
    let mut server = ServerConnection::new(server.config()).unwrap();
    let text = |side: &Result<(), Error>| side.as_ref().err().map(said).unwrap_or_default();
    match shake(&mut client, &mut server) {
        (Ok(()), Ok(())) if !client.is_handshaking() && !server.is_handshaking() => {
            Ok(Holder::of(&server.peer_certificates().unwrap()[0]).unwrap())
        }
        (client, server) => Err((text(&client), text(&server))),
    }
}

fn listens(identity: &Arc<Identity>, revoked: Option<Arc<Revoked>>) -> Server {
    Server::new(identity.clone(), revoked, &["h2"]).unwrap()
}

fn calls(identity: &Arc<Identity>) -> Client {
    Client::new(identity.clone(), None, &["h2"]).unwrap()
}

#[test]
fn both_sides_know_each_other_by_what_their_authority_says() {
    let mut place = Place::new();
    let (gcm, cart) = (place.issue("or1", Role::Gcm), place.issue("cart", Role::Host));
    let server = listens(&gcm, Some(place.revoked()));
    let known = meet(&server, &calls(&cart)).unwrap();
    assert_eq!((known.name.as_str(), known.role), ("cart", Role::Host));
    assert!(known.is_process("cart-left") && !known.is_process("other"));
    assert_eq!(known.to_string(), "host cart");
    assert_eq!(known, cart.holder());
}

#[test]
fn nobody_but_a_gcm_is_believed_to_be_one() {
    let mut place = Place::new();
    let (gcm, cart) = (place.issue("or1", Role::Gcm), place.issue("cart", Role::Host));
    let server = listens(&cart, None);
    let (why, _) = meet(&server, &calls(&gcm)).unwrap_err();
    assert!(why.contains("host cart") && why.contains("gcm is expected"), "{why}");
}

#[test]
fn a_stranger_and_one_of_another_authority_are_refused() {
    let (mut place, mut other) = (Place::new(), Place::new());
    let (gcm, foreign) = (place.issue("or1", Role::Gcm), other.issue("cart", Role::Host));
    let server = listens(&gcm, Some(place.revoked()));
    let (why, _) = meet(&server, &calls(&foreign)).unwrap_err();
    assert!(why.contains("another authority"), "the caller does not believe the gcm either: {why}");
    // A caller that believes everybody, and shows nothing or a foreign certificate.
    let mut roots = RootCertStore::empty();
    let authority = std::fs::read(place.authority.certificate()).unwrap();
    let pem = <CertificateDer<'_> as rustls::pki_types::pem::PemObject>::from_pem_slice(&authority).unwrap();
    roots.add(pem).unwrap();
    let builder = |versions: &[&'static rustls::SupportedProtocolVersion]| -> ConfigBuilder<ClientConfig, WantsVerifier> {
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        ClientConfig::builder_with_provider(provider).with_protocol_versions(versions).unwrap()
    };
    let silent = builder(&[&rustls::version::TLS13]).with_root_certificates(roots).with_no_client_auth();
    let mut client =
        ClientConnection::new(Arc::new(silent), ServerName::try_from("or1.local").unwrap()).unwrap();
    let mut port = ServerConnection::new(server.config()).unwrap();
    let (_, of_server) = shake(&mut client, &mut port);
    assert_eq!(said(&of_server.unwrap_err()), "it shows no certificate");
}

#[test]
fn what_was_revoked_is_refused_at_once_and_what_is_issued_anew_is_not() {
    let mut place = Place::new();
    let (gcm, anna) = (place.issue("or1", Role::Gcm), place.issue("anna", Role::Operator));
    let server = listens(&gcm, Some(place.revoked()));
    meet(&server, &calls(&anna)).unwrap();
    let gone = place.authority.revoke("anna").unwrap();
    assert_eq!(gone.iter().map(|one| one.number.clone()).collect::<Vec<_>>(), [anna.holder().number()]);
    let (_, why) = meet(&server, &calls(&anna)).unwrap_err();
    assert_eq!(why, "its certificate was revoked");
    assert!(server.revoked().unwrap().has(&anna.holder().serial));
    let calling = calls(&anna);
    let _again = place.issue("anna", Role::Operator);
    meet(&server, &calling).expect("the identity in the file is shown, and that is another one now");
    let unknown = place.authority.revoke("berta").unwrap_err().to_string();
    assert!(unknown.contains("berta") && unknown.contains("anna"), "{unknown}");
}

#[test]
fn a_list_or_an_identity_that_breaks_leaves_what_was_read_before() {
    let mut place = Place::new();
    let (gcm, anna) = (place.issue("or1", Role::Gcm), place.issue("anna", Role::Operator));
    let server = listens(&gcm, Some(place.revoked()));
    place.authority.revoke("anna").unwrap();
    let list = place.authority.revoked_list();
    assert!(server.revoked().unwrap().has(&anna.holder().serial));
    std::fs::write(&list, "nothing of the kind").unwrap();
    assert!(server.revoked().unwrap().has(&anna.holder().serial), "it was revoked");
    std::fs::remove_file(&list).unwrap();
    assert!(server.revoked().unwrap().has(&anna.holder().serial), "and is");
    std::fs::write(place.at("or1"), "nothing of the kind").unwrap();
    assert_eq!(gcm.holder().name, "or1");
}

#[test]
fn a_certificate_opens_nothing_before_and_after_its_time() {
    let mut place = Place::new();
    let (gcm, anna) = (place.issue("or1", Role::Gcm), place.issue("anna", Role::Operator));
    let (now, day) = (time::OffsetDateTime::now_utc(), time::Duration::days(1));
    for (from, until, of_gcm, of_anna) in [
        (now - day, now - day / 2, "has expired", "has expired"),
        (now + day / 2, now + day, "not valid yet", "not valid yet"),
    ] {
        let at = place.at("anna");
        place.authority.issue_for(&wish("anna", Role::Operator), (from, until), &at).unwrap();
        let (of_caller, of_port) = meet(&listens(&gcm, None), &calls(&anna)).unwrap_err();
        assert!(of_port.contains(of_anna), "{of_port}");
        assert!(of_caller.contains("this side") || of_caller.contains("ended it"), "{of_caller}");
        let late = place.at("late");
        place.authority.issue_for(&wish("late", Role::Gcm), (from, until), &late).unwrap();
        let late = Arc::new(Identity::read(&late).unwrap());
        place.issue("anna", Role::Operator);
        let (of_caller, _) = meet(&listens(&late, None), &calls(&anna)).unwrap_err();
        assert!(of_caller.contains(of_gcm), "{of_caller}");
    }
}

#[test]
fn a_list_of_another_authority_is_refused_where_it_is_named() {
    let (mut place, other) = (Place::new(), Place::new());
    let gcm = place.issue("or1", Role::Gcm);
    let why = Server::new(gcm.clone(), Some(other.revoked()), &["h2"]).unwrap_err();
    assert!(why.contains("another authority") && why.contains("revoked.crl"), "{why}");
    assert!(Client::new(gcm.clone(), Some(other.revoked()), &["h2"]).is_err());
    Client::new(gcm, Some(place.revoked()), &["h2"]).unwrap();
}

#[test]
fn an_authority_that_was_not_made_to_its_end_is_made_anew_and_one_that_others_write_is_none() {
    use std::os::unix::fs::PermissionsExt;

    let temp = tempfile::tempdir().unwrap();
    let dir = temp.path().join("authority");
    drop(Authority::init(&dir).unwrap());
    std::fs::remove_file(dir.join("issued.json")).unwrap();
    assert!(Authority::open(&dir).unwrap_err().to_string().contains("no authority"));
    drop(Authority::init(&dir).unwrap());
    drop(Authority::open(&dir).unwrap());
    std::fs::set_permissions(&dir, std::fs::Permissions::from_mode(0o777)).unwrap();
    let why = Authority::open(&dir).unwrap_err().to_string();
    assert!(why.contains("chmod 700"), "{why}");
}

#[test]
fn an_identity_that_lacks_a_part_or_that_others_read_is_refused_with_the_reason() {
    use std::os::unix::fs::PermissionsExt;

    let mut place = Place::new();
    place.issue("anna", Role::Viewer);
    let whole = std::fs::read_to_string(place.at("anna")).unwrap();
    let blocks: Vec<&str> = whole.split_inclusive("-----END").collect();
    assert_eq!(blocks.len(), 4, "key, certificate, authority");
    let parts: Vec<String> = whole.split("-----BEGIN ").skip(1).map(|p| format!("-----BEGIN {p}")).collect();
    let secret = |name: &str, content: &str| {
        std::fs::write(place.at(name), content).unwrap();
        std::fs::set_permissions(place.at(name), std::fs::Permissions::from_mode(0o600)).unwrap();
        place.at(name)
    };
    for (content, why) in [
        (String::new(), "private key"),
        (parts[0].clone(), "no certificate"),
        (format!("{}{}", parts[0], parts[1]), "of its authority is not in it"),
        (format!("{}{}", parts[1], parts[2]), "private key"),
        (format!("{}{}", parts[0], parts[2].repeat(2)), "not exactly one trocar:role"),
    ] {
        let error = Identity::read(&secret("broken", &content)).unwrap_err().to_string();
        assert!(error.contains(why) && error.contains("broken is no identity"), "{why}: {error}");
    }
    let open = secret("open", &whole);
    std::fs::set_permissions(&open, std::fs::Permissions::from_mode(0o644)).unwrap();
    let error = Identity::read(&open).unwrap_err().to_string();
    assert!(error.contains("chmod 600"), "{error}");
    assert!(Identity::read(Path::new("/nowhere")).unwrap_err().to_string().contains("No such file"));
}

#[test]
fn an_authority_says_what_makes_no_sense_and_replaces_nobody_elses_file() {
    let mut place = Place::new();
    let out = place.at("x");
    for (wish, why) in [
        (Wish { name: "an na".into(), ..wish("a", Role::Viewer) }, "is no name"),
        (Wish { name: String::new(), ..wish("a", Role::Viewer) }, "is no name"),
        (Wish { processes: Vec::new(), ..wish("a", Role::Host) }, "--process NAME"),
        (Wish { processes: vec!["a*b".into()], ..wish("a", Role::Host) }, "neither a process"),
        (Wish { processes: vec!["left".into()], ..wish("a", Role::Operator) }, "operator is no process"),
        (Wish { addresses: vec!["10.0.0.1:50551".into()], ..wish("a", Role::Gcm) }, "takes no port"),
        (Wish { addresses: vec!["gcm.Trocar".into()], ..wish("a", Role::Host) }, "tell roles"),
        (Wish { days: 0, ..wish("a", Role::Gcm) }, "0 days"),
    ] {
        let error = place.authority.issue(&wish, &out).unwrap_err().to_string();
        assert!(error.contains(why) && !out.exists(), "{why}: {error}");
    }
    std::fs::write(&out, "mine").unwrap();
    let error = place.authority.issue(&wish("a", Role::Gcm), &out).unwrap_err().to_string();
    assert!(error.contains("name another file"), "{error}");
    assert_eq!(std::fs::read_to_string(&out).unwrap(), "mine");
    let dir = place.at("authority");
    assert!(Authority::init(&dir).unwrap_err().to_string().contains("already"));
    assert!(Authority::open(&place.at("none")).unwrap_err().to_string().contains("no authority"));
    place.issue("anna", Role::Viewer);
    // Nobody else reads the books while somebody may write them.
    let Place { dir: _stays, authority } = place;
    drop(authority);
    let again = Authority::open(&dir).unwrap();
    assert_eq!(again.issued().len(), 1, "what was refused was not issued");
    assert_eq!((again.issued()[0].name.as_str(), again.issued()[0].revoked), ("anna", None));
}
