//! The certificates that are valid no more, by the authority's list.

use std::path::{Path, PathBuf};

use parking_lot::Mutex;
use rustls::RootCertStore;
use rustls::pki_types::CertificateRevocationListDer;
use rustls::pki_types::pem::PemObject;
use webpki::{CertRevocationList, OwnedCertRevocationList};

use crate::files::Stamp;

/// The authority's list of revoked certificates, read from its file, and again whenever that is another one.
#[derive(Debug)]
pub struct Revoked {
    path: PathBuf,
    now: Mutex<Read>,
}

#[derive(Debug)]
struct Read {
    written: Option<Stamp>,
    /// Counts up with each list that was read.
    edition: u64,
    der: CertificateRevocationListDer<'static>,
    list: CertRevocationList<'static>,
}

impl Revoked {
    /// # Errors
    /// The file cannot be read, or is no list.
    pub fn read(path: &Path) -> Result<Revoked, String> {
        let now = read(path, 1)?;
        Ok(Revoked { path: path.to_owned(), now: Mutex::new(now) })
    }

    /// Reads the file again if it is another one; returns the number of the edition that holds now. A file
    /// that cannot be read is told of, and the list before it holds.
    pub fn look(&self) -> u64 {
        let mut now = self.now.lock();
        let written = Stamp::of(&self.path);
        if written != now.written {
            match read(&self.path, now.edition + 1) {
                Ok(read) => *now = read,
                Err(why) => {
                    log::warn!("{why}; the list that was read before holds");
                    now.written = written;
                }
            }
        }
        now.edition
    }

    /// Tells whether the certificate of this number is revoked.
    pub fn has(&self, serial: &[u8]) -> bool {
        self.look();
        // A list that cannot be searched says nothing good of anybody.
        self.now.lock().list.find_serial(serial).map_or(true, |found| found.is_some())
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Tells whether one of these authorities has made the list.
    pub(crate) fn is_of(&self, roots: &RootCertStore) -> bool {
        let now = self.now.lock();
        roots.roots.iter().any(|root| root.subject.as_ref() == now.list.issuer())
    }

    pub(crate) fn der(&self) -> CertificateRevocationListDer<'static> {
        self.now.lock().der.clone()
    }
}

fn read(path: &Path, edition: u64) -> Result<Read, String> {
    let written = Stamp::of(path);
    let text = std::fs::read(path).map_err(|e| format!("{} cannot be read: {e}", path.display()))?;
    let no_list = |e: String| format!("{} is no list of revoked certificates: {e}", path.display());
    let der = CertificateRevocationListDer::from_pem_slice(&text).map_err(|e| no_list(e.to_string()))?;
    let list = OwnedCertRevocationList::from_der(&der).map_err(|e| no_list(format!("{e:?}")))?;
    Ok(Read { written, edition, der, list: list.into() })
}
