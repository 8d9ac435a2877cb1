//! Decides which plugin files this host takes, from ownership, mode and hash alone.
//!
//! Invariant: deciding is pure; nothing here opens a plugin. The strict mode only ever refuses more than
//! `dev`.

use std::collections::BTreeSet;
use std::io::Read;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::Deserialize;

use super::{Fault, Hash, StoreError};

/// The trust mode of a store; `dev` is the default.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Trust {
    /// Own files and root's; group-writable ones with a warning.
    #[default]
    Dev,
    /// Only files whose sha256 is listed.
    AllowList(AllowList),
}

/// The hashes of a JSON file `{"sha256": ["…"]}`.
#[derive(Clone, Debug, PartialEq)]
pub struct AllowList {
    file: PathBuf,
    hashes: BTreeSet<Hash>,
}

/// Result of `fstat` on an opened file, and the user that asks.
#[derive(Clone, Copy, Debug)]
pub struct Ownership {
    pub uid: u32,
    pub mode: u32,
    pub own_uid: u32,
}

/// Larger allow lists are not read, bytes.
const ALLOW_LIST_LIMIT: u64 = 4 << 20;

impl FromStr for Trust {
    type Err = StoreError;

    /// `dev` or `allowlist:FILE`.
    fn from_str(text: &str) -> Result<Trust, StoreError> {
        match text.split_once(':') {
            _ if text == "dev" => Ok(Trust::Dev),
            _ if text.starts_with("signed") => Err(StoreError::TrustSigned),
            Some(("allowlist", file)) if !file.is_empty() => {
                AllowList::read(Path::new(file)).map(Trust::AllowList)
            }
            _ => Err(StoreError::TrustUnknown { asked: text.into() }),
        }
    }
}

impl Trust {
    /// True when symbolic links are refused even inside the plugin directory.
    pub fn refuses_links(&self) -> bool {
        matches!(self, Trust::AllowList(_))
    }

    /// Judges owner and mode; the answer is what to warn about.
    pub fn judge_owner(&self, file: Ownership) -> Result<Vec<String>, Fault> {
        if file.uid != file.own_uid && file.uid != 0 {
            return Err(Fault::ForeignOwner { owner: file.uid, own: file.own_uid });
        }
        if file.mode & 0o002 != 0 {
            return Err(Fault::WorldWritable { mode: file.mode });
        }
        if file.mode & 0o020 == 0 {
            return Ok(Vec::new());
        }
        match self {
            Trust::Dev => Ok(vec![format!("writable by its group (mode {:o})", file.mode & 0o7777)]),
            Trust::AllowList(_) => Err(Fault::GroupWritable { mode: file.mode }),
        }
    }

    pub fn judge_hash(&self, hash: &Hash) -> Result<(), Fault> {
        match self {
            Trust::Dev => Ok(()),
            Trust::AllowList(list) if list.hashes.contains(hash) => Ok(()),
            Trust::AllowList(list) => Err(Fault::NotAllowed { hash: *hash, list: list.file.clone() }),
        }
    }
}

impl AllowList {
    pub fn new(file: impl Into<PathBuf>, hashes: impl IntoIterator<Item = Hash>) -> AllowList {
        AllowList { file: file.into(), hashes: hashes.into_iter().collect() }
    }

    /// Reads the list; a list others may write is refused like a plugin they may write.
    pub fn read(path: &Path) -> Result<AllowList, StoreError> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Listed {
            sha256: Vec<String>,
        }
        let wrong = |because: String| StoreError::AllowList { file: path.into(), because };
        let file = std::fs::OpenOptions::new()
            .read(true)
            .custom_flags(libc::O_NONBLOCK | libc::O_CLOEXEC)
            .open(path)
            .map_err(|e| wrong(e.to_string()))?;
        let meta = file.metadata().map_err(|e| wrong(e.to_string()))?;
        if !meta.is_file() {
            return Err(wrong("it is not a regular file".into()));
        }
        let owner = Ownership { uid: meta.uid(), mode: meta.mode(), own_uid: super::file::own_uid() };
        Trust::AllowList(AllowList::new(path, []))
            .judge_owner(owner)
            .map_err(|fault| wrong(format!("it {fault}")))?;
        let mut text = String::new();
        file.take(ALLOW_LIST_LIMIT).read_to_string(&mut text).map_err(|e| wrong(e.to_string()))?;
        let listed: Listed = serde_json::from_str(&text).map_err(|e| wrong(e.to_string()))?;
        let parse = |(i, text): (usize, &String)| {
            Hash::parse(text)
                .ok_or_else(|| wrong(format!("entry {i} of sha256 is not 64 hex digits: `{text}`")))
        };
        let hashes = listed.sha256.iter().enumerate().map(parse).collect::<Result<_, _>>()?;
        Ok(AllowList { file: path.into(), hashes })
    }
}

#[cfg(test)]
#[path = "trust_tests.rs"]
mod tests;
