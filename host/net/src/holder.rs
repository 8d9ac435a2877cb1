//! The holder of a certificate: its name, role and processes, as the authority wrote them into it.
//!
//! In a certificate each of them is a URI among its alternative names, `trocar:name:NAME`,
//! `trocar:role:ROLE`, `trocar:process:PATTERN`. Invariant: a certificate without exactly one name and one
//! role belongs to nobody.

use std::fmt;

use rustls::pki_types::CertificateDer;
use webpki::EndEntityCert;

use crate::role::Role;

const NAME: &str = "trocar:name:";
const ROLE: &str = "trocar:role:";
const PROCESS: &str = "trocar:process:";

/// The holder of a certificate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    pub name: String,
    pub role: Role,
    /// Processes it may be: names, or beginnings of names with a `*` behind them.
    pub processes: Vec<String>,
    /// The certificate's number.
    pub serial: Vec<u8>,
}

impl Holder {
    /// # Errors
    /// It is no certificate, or none of an authority of ours.
    pub fn of(certificate: &CertificateDer<'_>) -> Result<Holder, String> {
        let read = EndEntityCert::try_from(certificate).map_err(|e| format!("no certificate: {e:?}"))?;
        let said: Vec<&str> = read.valid_uri_names().collect();
        let all = |what: &'static str| said.iter().filter_map(move |uri| uri.strip_prefix(what));
        let one = |what: &'static str| {
            let mut found = all(what);
            match (found.next(), found.next()) {
                (Some(one), None) => Ok(one.to_owned()),
                _ => Err(format!("its certificate says not exactly one {}", what.trim_end_matches(':'))),
            }
        };
        let role = one(ROLE)?.parse()?;
        let processes = all(PROCESS).map(str::to_owned).collect();
        Ok(Holder { name: one(NAME)?, role, processes, serial: read.serial().to_vec() })
    }

    /// The words in a certificate of that name, role and processes.
    pub(crate) fn uris(name: &str, role: Role, processes: &[String]) -> Vec<String> {
        let processes = processes.iter().map(|process| format!("{PROCESS}{process}"));
        [format!("{NAME}{name}"), format!("{ROLE}{role}")].into_iter().chain(processes).collect()
    }

    /// Tells whether it may be the process of this name.
    pub fn is_process(&self, process: &str) -> bool {
        self.processes.iter().any(|pattern| match pattern.strip_suffix('*') {
            Some(beginning) => process.starts_with(beginning),
            None => process == pattern,
        })
    }

    /// The certificate's number, as tools print it.
    pub fn number(&self) -> String {
        hex(&self.serial)
    }
}

impl fmt::Display for Holder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.role, self.name)
    }
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_is_named_or_begins_as_named() {
        let processes = vec!["left".to_owned(), "cart-*".to_owned()];
        let holder = Holder { name: "cart".into(), role: Role::Host, processes, serial: vec![1, 255] };
        let may = ["left", "cart-1", "cart-"].map(|process| holder.is_process(process));
        let may_not = ["lef", "left2", "cart", "Cart-1", ""].map(|process| holder.is_process(process));
        assert_eq!((may, may_not), ([true; 3], [false; 5]));
        assert_eq!(holder.number(), "01ff");
    }
}
