//! The authority of a system: a directory with its key, what it has issued, and what it has revoked.
//!
//! Invariant: a certificate is on the list of the issued before anybody has it, so that each can be revoked.

use std::fmt;
use std::fs::{self, DirBuilder, File};
use std::net::IpAddr;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

use rcgen::{
    BasicConstraints, CertificateParams, CertificateRevocationListParams, DnType, ExtendedKeyUsagePurpose,
    IsCa, Issuer, KeyIdMethod, KeyPair, KeyUsagePurpose, RevokedCertParams, SanType, SerialNumber,
    string::Ia5String,
};
use rustix::fs::FlockOperation;
use serde::{Deserialize, Serialize};
use time::{Duration, OffsetDateTime};

use crate::files;
use crate::holder::{Holder, hex};
use crate::identity::Identity;
use crate::role::Role;

const CERTIFICATE: &str = "authority.pem";
const KEY: &str = "authority.key";
const ISSUED: &str = "issued.json";
const REVOKED: &str = "revoked.crl";

/// A certificate of an authority holds so long, days.
const AUTHORITY_DAYS: i64 = 3650;
/// Clocks of other machines may be this much behind.
const BEHIND: Duration = Duration::minutes(10);
/// Name in every certificate of a GCM, for libraries that know a server by a name alone. Nobody else has it.
const GCM: &str = "gcm.trocar";
/// Bytes of a certificate's number.
const SERIAL: usize = 16;
/// Characters of a name.
const MOST_NAME: usize = 64;

/// A system's authority, in its directory.
#[derive(Debug)]
pub struct Authority {
    dir: PathBuf,
    books: Books,
    /// Locked: nobody else reads or writes the books meanwhile.
    _lock: File,
}

/// The memory of an authority.
#[derive(Debug, Serialize, Deserialize)]
struct Books {
    /// The name in its own certificate, which no other authority has.
    name: String,
    issued: Vec<Issued>,
}

/// A certificate that was issued.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Issued {
    /// Its number, hex.
    pub number: String,
    pub name: String,
    pub role: String,
    pub processes: Vec<String>,
    pub addresses: Vec<String>,
    /// Until when it is valid, in seconds since 1970.
    pub until: i64,
    /// When it was revoked, in seconds since 1970.
    pub revoked: Option<i64>,
}

/// A certificate that is wanted.
#[derive(Clone, Debug)]
pub struct Wish {
    pub name: String,
    pub role: Role,
    /// Processes the holder may be: names, or beginnings of names with a `*` behind them.
    pub processes: Vec<String>,
    /// Addresses and names under which others reach it: browsers and grpcurl compare them.
    pub addresses: Vec<String>,
    pub days: u32,
}

/// Why an authority does not do as asked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AuthorityError {
    /// There is one already.
    Exists { dir: PathBuf },
    /// There is none.
    Missing { dir: PathBuf },
    /// The wish makes no sense.
    Unfit { why: String },
    /// No certificate of that name or number is valid.
    Unknown { what: String, known: Vec<String> },
    /// A file of it cannot be read, written or understood.
    Broken { why: String },
}

impl fmt::Display for AuthorityError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            AuthorityError::Exists { dir } => write!(f, "there is an authority in {} already", dir.display()),
            AuthorityError::Missing { dir } => write!(f, "there is no authority in {}", dir.display()),
            AuthorityError::Unfit { why } | AuthorityError::Broken { why } => f.write_str(why),
            AuthorityError::Unknown { what, known } if known.is_empty() => {
                write!(f, "no valid certificate is of \"{what}\": this authority has issued none")
            }
            AuthorityError::Unknown { what, known } => {
                write!(f, "no valid certificate is of \"{what}\": those of {} are", known.join(", "))
            }
        }
    }
}

impl std::error::Error for AuthorityError {}

fn broken(what: &Path) -> impl Fn(&dyn fmt::Display) -> AuthorityError {
    let what = what.display().to_string();
    move |e| AuthorityError::Broken { why: format!("{what}: {e}") }
}

fn unfit(why: impl Into<String>) -> AuthorityError {
    AuthorityError::Unfit { why: why.into() }
}

impl Authority {
    /// Makes an authority in a directory of its own, which only this user enters.
    ///
    /// # Errors
    /// There is one, or it cannot be written there.
    pub fn init(dir: &Path) -> Result<Authority, AuthorityError> {
        let said = broken(dir);
        DirBuilder::new().recursive(true).mode(0o700).create(dir).map_err(|e| said(&e))?;
        // Written last: without it there is none yet. Whoever waits for a lock here may find one afterwards.
        let is_there = || match dir.join(ISSUED).exists() {
            true => Err(AuthorityError::Exists { dir: dir.to_owned() }),
            false => Ok(()),
        };
        is_there()?;
        let lock = lock(dir)?;
        is_there()?;
        let key = KeyPair::generate().map_err(|e| said(&e))?;
        let name = format!("trocar authority {}", hex(&number()?.to_bytes()[..4]));
        let mut params = own(&name);
        params.serial_number = Some(number()?);
        let now = OffsetDateTime::now_utc();
        (params.not_before, params.not_after) = (now - BEHIND, now + Duration::days(AUTHORITY_DAYS));
        let certificate = params.self_signed(&key).map_err(|e| said(&e))?;
        files::write(&dir.join(KEY), &key.serialize_pem(), true).map_err(|e| said(&e))?;
        files::write(&dir.join(CERTIFICATE), &certificate.pem(), false).map_err(|e| said(&e))?;
        let books = Books { name, issued: Vec::new() };
        let authority = Authority { dir: dir.to_owned(), books, _lock: lock };
        authority.keep()?;
        Ok(authority)
    }

    /// # Errors
    /// There is none, or a file of it cannot be read.
    pub fn open(dir: &Path) -> Result<Authority, AuthorityError> {
        if !dir.join(ISSUED).exists() {
            return Err(AuthorityError::Missing { dir: dir.to_owned() });
        }
        let lock = lock(dir)?;
        let list = dir.join(ISSUED);
        let said = broken(&list);
        let text = fs::read_to_string(&list).map_err(|e| said(&e))?;
        let books = serde_json::from_str(&text).map_err(|e| said(&e))?;
        Ok(Authority { dir: dir.to_owned(), books, _lock: lock })
    }

    /// The list of revoked certificates, for those who have to know.
    pub fn revoked_list(&self) -> PathBuf {
        self.dir.join(REVOKED)
    }

    /// The authority's own certificate: browsers and other programs believe it.
    pub fn certificate(&self) -> PathBuf {
        self.dir.join(CERTIFICATE)
    }

    pub fn issued(&self) -> &[Issued] {
        &self.books.issued
    }

    /// Issues a certificate, and writes it with its key to `out`, where only this user reads it. A file there
    /// is replaced only if it is an identity of the same name: processes that run with it take the new one.
    ///
    /// # Errors
    /// The wish makes no sense, or something cannot be written.
    pub fn issue(&mut self, wish: &Wish, out: &Path) -> Result<Issued, AuthorityError> {
        check(wish)?;
        let now = OffsetDateTime::now_utc();
        self.issue_for(wish, (now - BEHIND, now + Duration::days(wish.days.into())), out)
    }

    /// Issues one that is valid from the first of these times to the second.
    pub(crate) fn issue_for(
        &mut self,
        wish: &Wish,
        (from, until): (OffsetDateTime, OffsetDateTime),
        out: &Path,
    ) -> Result<Issued, AuthorityError> {
        if out.exists() {
            let another = |why: String| unfit(format!("{why}: name another file than {}", out.display()));
            let there = Identity::read(out).map_err(|e| another(e.to_string()))?.holder();
            if there.name != wish.name {
                return Err(another(format!("an identity of the {there} is there")));
            }
        }
        let said = broken(&self.dir);
        let serial = number()?;
        let key = KeyPair::generate().map_err(|e| said(&e))?;
        let mut params = CertificateParams::default();
        params.distinguished_name.push(DnType::CommonName, wish.name.as_str());
        params.serial_number = Some(serial.clone());
        (params.not_before, params.not_after) = (from, until);
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages =
            vec![ExtendedKeyUsagePurpose::ClientAuth, ExtendedKeyUsagePurpose::ServerAuth];
        params.use_authority_key_identifier_extension = true;
        let uris = Holder::uris(&wish.name, wish.role, &wish.processes).into_iter();
        let uris = uris.map(|uri| Ia5String::try_from(uri).map(SanType::URI));
        let gcm = (wish.role == Role::Gcm).then(|| Ia5String::try_from(GCM).map(SanType::DnsName));
        let addresses = wish.addresses.iter().map(|address| match address.parse::<IpAddr>() {
            Ok(ip) => Ok(SanType::IpAddress(ip)),
            Err(_) => Ia5String::try_from(address.as_str()).map(SanType::DnsName),
        });
        params.subject_alt_names =
            uris.chain(gcm).chain(addresses).collect::<Result<_, _>>().map_err(|e| said(&e))?;
        let (issuer, authority) = self.issuer()?;
        let certificate = params.signed_by(&key, &issuer).map_err(|e| said(&e))?;
        let issued = Issued {
            number: hex(&serial.to_bytes()),
            name: wish.name.clone(),
            role: wish.role.to_string(),
            processes: wish.processes.clone(),
            addresses: wish.addresses.clone(),
            until: params.not_after.unix_timestamp(),
            revoked: None,
        };
        self.books.issued.push(issued.clone());
        self.keep()?;
        let text = format!("{}{}{authority}", key.serialize_pem(), certificate.pem());
        files::write(out, &text, true).map_err(|e| broken(out)(&e))?;
        Ok(issued)
    }

    /// Revokes all valid certificates of that name, or the one of that number; returns them.
    ///
    /// # Errors
    /// There is none, or the list cannot be written.
    pub fn revoke(&mut self, what: &str) -> Result<Vec<Issued>, AuthorityError> {
        let now = OffsetDateTime::now_utc().unix_timestamp();
        let is_valid = |one: &Issued| one.revoked.is_none() && one.until > now;
        let (mut gone, mut known) = (Vec::new(), Vec::new());
        for one in self.books.issued.iter_mut().filter(|one| is_valid(one)) {
            if one.name == what || one.number == what.to_ascii_lowercase() {
                one.revoked = Some(now);
                gone.push(one.clone());
            } else if !known.contains(&one.name) {
                known.push(one.name.clone());
            }
        }
        let is_gone = |one: &Issued| {
            one.revoked.is_some() && (one.name == what || one.number == what.to_ascii_lowercase())
        };
        if gone.is_empty() && self.books.issued.iter().any(is_gone) {
            // The list may not have come to disk when it was revoked.
            self.keep()?;
        }
        if gone.is_empty() {
            return Err(AuthorityError::Unknown { what: what.to_owned(), known });
        }
        self.keep()?;
        Ok(gone)
    }

    fn issuer(&self) -> Result<(Issuer<'static, KeyPair>, String), AuthorityError> {
        let key = files::read_secret(&self.dir.join(KEY)).map_err(|why| AuthorityError::Broken { why })?;
        let at = self.dir.join(CERTIFICATE);
        let said = broken(&at);
        let key = KeyPair::from_pem(&key).map_err(|e| broken(&self.dir.join(KEY))(&e))?;
        let text = fs::read_to_string(&at).map_err(|e| said(&e))?;
        let issuer = Issuer::new(own(&self.books.name), key);
        Ok((issuer, text))
    }

    /// Writes the lists: first what is revoked, so that nobody is taken for revoked who is not on that list.
    fn keep(&self) -> Result<(), AuthorityError> {
        let said = broken(&self.dir);
        let now = OffsetDateTime::now_utc();
        let revoked = self.books.issued.iter().filter_map(|one| {
            let at = OffsetDateTime::from_unix_timestamp(one.revoked?).ok()?;
            Some(RevokedCertParams {
                serial_number: SerialNumber::from_slice(&bytes(&one.number)),
                revocation_time: at,
                reason_code: None,
                invalidity_date: None,
            })
        });
        let list = CertificateRevocationListParams {
            this_update: now - BEHIND,
            // It holds until there is another one: an authority is not asked each day.
            next_update: now + Duration::days(AUTHORITY_DAYS),
            crl_number: SerialNumber::from((now.unix_timestamp_nanos() / 1_000_000).unsigned_abs() as u64),
            issuing_distribution_point: None,
            revoked_certs: revoked.collect(),
            key_identifier_method: KeyIdMethod::Sha256,
        };
        let list = list.signed_by(&self.issuer()?.0).map_err(|e| said(&e))?;
        let text = list.pem().map_err(|e| said(&e))?;
        files::write(&self.revoked_list(), &text, false).map_err(|e| said(&e))?;
        let text = serde_json::to_string_pretty(&self.books).map_err(|e| said(&e))?;
        files::write(&self.dir.join(ISSUED), &(text + "\n"), false).map_err(|e| said(&e))
    }
}

/// Waits until nobody else uses the authority.
///
/// # Errors
/// Others may write into its directory: then it could be anybody's.
fn lock(dir: &Path) -> Result<File, AuthorityError> {
    let said = broken(dir);
    let lock = File::open(dir).map_err(|e| said(&e))?;
    if !files::is_own(&lock.metadata().map_err(|e| said(&e))?, 0o022) {
        return Err(said(&format!("others may write there: `chmod 700 {}`, as its user", dir.display())));
    }
    rustix::fs::flock(&lock, FlockOperation::LockExclusive).map_err(|e| said(&e))?;
    Ok(lock)
}

/// The authority itself, as its certificate has it.
fn own(name: &str) -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name.push(DnType::CommonName, name);
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    params
}

/// A number that no other certificate has.
fn number() -> Result<SerialNumber, AuthorityError> {
    let mut bytes = [0; SERIAL];
    let flags = rustix::rand::GetRandomFlags::empty();
    let got = rustix::rand::getrandom(&mut bytes, flags).map_err(|e| broken(Path::new("getrandom"))(&e))?;
    if got < SERIAL {
        return Err(AuthorityError::Broken { why: "the machine has no random numbers".into() });
    }
    // Positive, and of full length.
    bytes[0] = bytes[0] & 0x7f | 0x40;
    Ok(SerialNumber::from_slice(&bytes))
}

fn bytes(hex: &str) -> Vec<u8> {
    let pair = |at| u8::from_str_radix(hex.get(at..at + 2).unwrap_or_default(), 16).unwrap_or_default();
    (0..hex.len() / 2).map(|n| pair(2 * n)).collect()
}

fn check(wish: &Wish) -> Result<(), AuthorityError> {
    let is_plain = |text: &str, more: &str| {
        (1..=MOST_NAME).contains(&text.len())
            && text.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c) || more.contains(c))
    };
    let Wish { name, role, processes, addresses, days } = wish;
    if !is_plain(name, "@") {
        return Err(unfit(format!(
            "\"{name}\" is no name: it has 1 to {MOST_NAME} letters, digits, and - _ . @ in it"
        )));
    }
    if let Some(wrong) = processes.iter().find(|one| {
        !is_plain(one.strip_suffix('*').filter(|rest| !rest.is_empty()).unwrap_or(one), "") && *one != "*"
    }) {
        return Err(unfit(format!(
            "\"{wrong}\" is neither a process nor the beginning of one with a * behind it"
        )));
    }
    if *role == Role::Host && processes.is_empty() {
        return Err(unfit("a host has to be told which processes it is: --process NAME, or 'NAME*'"));
    }
    if !matches!(role, Role::Host | Role::Gcm) && !processes.is_empty() {
        return Err(unfit(format!("a {role} is no process: --process is for the roles host and gcm")));
    }
    if let Some(wrong) =
        addresses.iter().find(|one| one.to_ascii_lowercase().trim_end_matches('.').ends_with(".trocar"))
    {
        return Err(unfit(format!(
            "\"{wrong}\": names that end in .trocar tell roles, and are given with them"
        )));
    }
    if let Some(wrong) = addresses.iter().find(|one| one.parse::<IpAddr>().is_err() && !is_plain(one, "")) {
        return Err(unfit(format!(
            "\"{wrong}\" is neither an IP address nor a name: --address takes no port"
        )));
    }
    if !(1..=AUTHORITY_DAYS).contains(&i64::from(*days)) {
        return Err(unfit(format!("{days} days: give 1 to {AUTHORITY_DAYS}")));
    }
    Ok(())
}
