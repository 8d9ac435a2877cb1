//! The identity that a process shows: its key and certificate, and the authority it trusts, in one PEM file.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parking_lot::Mutex;
use rustls::RootCertStore;
use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::sign::CertifiedKey;

use crate::files::{self, Stamp};
use crate::holder::Holder;

/// An identity, read from its file; and again when that file is another one, since certificates are
/// short-lived and replaced while processes run.
#[derive(Debug)]
pub struct Identity {
    path: PathBuf,
    now: Mutex<Read>,
}

#[derive(Clone, Debug)]
struct Read {
    written: Option<Stamp>,
    key: Arc<CertifiedKey>,
    holder: Holder,
    roots: Arc<RootCertStore>,
}

/// Why an identity cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IdentityError {
    pub path: PathBuf,
    pub why: String,
}

impl fmt::Display for IdentityError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} is no identity: {}", self.path.display(), self.why)
    }
}

impl std::error::Error for IdentityError {}

impl Identity {
    /// Reads the file that `trocar ca issue` wrote.
    ///
    /// # Errors
    /// It is missing, others can read it, or it lacks a part.
    pub fn read(path: &Path) -> Result<Identity, IdentityError> {
        let now = read(path).map_err(|why| IdentityError { path: path.to_owned(), why })?;
        Ok(Identity { path: path.to_owned(), now: Mutex::new(now) })
    }

    /// The holder that it shows.
    pub fn holder(&self) -> Holder {
        self.now().holder
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn key(&self) -> Arc<CertifiedKey> {
        self.now().key
    }

    /// The authorities whose certificates are believed.
    pub(crate) fn roots(&self) -> Arc<RootCertStore> {
        self.now().roots
    }

    /// The present content of the file. One that cannot be used is told of, and what was there before holds.
    fn now(&self) -> Read {
        let mut now = self.now.lock();
        let written = Stamp::of(&self.path);
        if written != now.written {
            match read(&self.path) {
                Ok(read) => *now = read,
                Err(why) => {
                    log::warn!("{}: {why}; the identity that was read before holds", self.path.display());
                    // Said once for each change.
                    now.written = written;
                }
            }
        }
        now.clone()
    }
}

fn read(path: &Path) -> Result<Read, String> {
    let written = Stamp::of(path);
    let text = files::read_secret(path)?;
    let key = PrivateKeyDer::from_pem_slice(text.as_bytes()).map_err(|e| format!("its private key: {e}"))?;
    let certificates: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(text.as_bytes()).collect();
    let certificates = certificates.map_err(|e| format!("its certificates: {e}"))?;
    let [own, authority @ ..] = certificates.as_slice() else {
        return Err("there is no certificate in it".into());
    };
    if authority.is_empty() {
        return Err("the certificate of its authority is not in it".into());
    }
    let holder = Holder::of(own)?;
    let mut roots = RootCertStore::empty();
    for one in authority {
        roots.add(one.clone()).map_err(|e| format!("the certificate of its authority: {e}"))?;
    }
    let key = CertifiedKey::from_der(vec![own.clone()], key, &ring::default_provider())
        .map_err(|e| format!("key and certificate: {e}"))?;
    let (key, roots) = (Arc::new(key), Arc::new(roots));
    Ok(Read { written, key, holder, roots })
}
