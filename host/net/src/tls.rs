//! Both sides of an encrypted connection: what each shows, and what it believes of the other.
//!
//! TLS 1.3 alone, certificates on both sides. Invariant: a peer is known by its certificate, never by the
//! address it was found at: machines get other addresses, their certificates stay.

use std::sync::Arc;

use parking_lot::Mutex;
use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::client::{ResolvesClientCert, Resumption, verify_server_cert_signed_by_trust_anchor};
use rustls::crypto::{CryptoProvider, ring, verify_tls13_signature};
use rustls::pki_types::{CertificateDer, ServerName, UnixTime};
use rustls::server::danger::{ClientCertVerified, ClientCertVerifier};
use rustls::server::{ClientHello, ParsedCertificate, ResolvesServerCert, WebPkiClientVerifier};
use rustls::sign::CertifiedKey;
use rustls::{
    AlertDescription, CertificateError, ClientConfig, DigitallySignedStruct, DistinguishedName, Error,
    OtherError, ServerConfig, SignatureScheme,
};

use crate::holder::Holder;
use crate::identity::Identity;
use crate::revoked::Revoked;
use crate::role::Role;

fn provider() -> Arc<CryptoProvider> {
    Arc::new(ring::default_provider())
}

/// # Errors
/// The list of revoked certificates is of another authority: nothing on it could be found.
fn is_of_ours(identity: &Identity, revoked: Option<&Revoked>) -> Result<(), String> {
    match revoked {
        Some(list) if !list.is_of(&identity.roots()) => Err(format!(
            "the list {} is of another authority than {}",
            list.path().display(),
            identity.path().display()
        )),
        _ => Ok(()),
    }
}

/// Shows the identity as it is when a connection begins.
#[derive(Debug)]
struct Shows(Arc<Identity>);

impl ResolvesServerCert for Shows {
    fn resolve(&self, _: ClientHello<'_>) -> Option<Arc<CertifiedKey>> {
        Some(self.0.key())
    }
}

impl ResolvesClientCert for Shows {
    fn resolve(&self, _: &[&[u8]], _: &[SignatureScheme]) -> Option<Arc<CertifiedKey>> {
        Some(self.0.key())
    }

    fn has_certs(&self) -> bool {
        true
    }
}

/// The needs of a listener.
#[derive(Clone, Debug)]
pub struct Server {
    config: Arc<ServerConfig>,
    revoked: Option<Arc<Revoked>>,
}

impl Server {
    /// `protocols`: those it speaks, the best first (ALPN).
    ///
    /// # Errors
    /// The library does not take the identity.
    pub fn new(
        identity: Arc<Identity>,
        revoked: Option<Arc<Revoked>>,
        protocols: &[&str],
    ) -> Result<Server, String> {
        is_of_ours(&identity, revoked.as_deref())?;
        let trust = Arc::new(TrustsCallers::new(identity.clone(), revoked.clone())?);
        let mut config = ServerConfig::builder_with_provider(provider())
            .with_protocol_versions(&[&rustls::version::TLS13])
            .map_err(|e| e.to_string())?
            .with_client_cert_verifier(trust)
            .with_cert_resolver(Arc::new(Shows(identity)));
        config.alpn_protocols = protocols.iter().map(|name| name.as_bytes().to_vec()).collect();
        // A session that is taken up again shows no certificate: each caller is to be judged.
        config.send_tls13_tickets = 0;
        Ok(Server { config: Arc::new(config), revoked })
    }

    pub fn config(&self) -> Arc<ServerConfig> {
        self.config.clone()
    }

    /// The list of revoked certificates it looks into.
    pub fn revoked(&self) -> Option<&Arc<Revoked>> {
        self.revoked.as_ref()
    }
}

/// Believes callers whose certificate its authority has issued and not revoked.
#[derive(Debug)]
struct TrustsCallers {
    identity: Arc<Identity>,
    revoked: Option<Arc<Revoked>>,
    /// By the edition of the list, the number of the identity's certificate.
    made: Mutex<(u64, Vec<u8>, Arc<dyn ClientCertVerifier>)>,
}

impl TrustsCallers {
    fn new(identity: Arc<Identity>, revoked: Option<Arc<Revoked>>) -> Result<TrustsCallers, String> {
        let edition = revoked.as_ref().map_or(0, |list| list.look());
        let made = verifier(&identity, revoked.as_deref())?;
        let made = Mutex::new((edition, identity.holder().serial, made));
        Ok(TrustsCallers { identity, revoked, made })
    }

    fn now(&self) -> Arc<dyn ClientCertVerifier> {
        let edition = self.revoked.as_ref().map_or(0, |list| list.look());
        let serial = self.identity.holder().serial;
        let mut made = self.made.lock();
        if (made.0, &made.1) != (edition, &serial) {
            match verifier(&self.identity, self.revoked.as_deref()) {
                Ok(now) => *made = (edition, serial, now),
                Err(why) => log::warn!("{why}; callers are judged as before"),
            }
        }
        made.2.clone()
    }
}

fn verifier(identity: &Identity, revoked: Option<&Revoked>) -> Result<Arc<dyn ClientCertVerifier>, String> {
    let builder = WebPkiClientVerifier::builder_with_provider(identity.roots(), provider());
    let builder = match revoked {
        Some(list) => builder.with_crls([list.der()]).only_check_end_entity_revocation(),
        None => builder,
    };
    builder.build().map_err(|e| e.to_string())
}

impl ClientCertVerifier for TrustsCallers {
    fn root_hint_subjects(&self) -> &[DistinguishedName] {
        &[]
    }

    fn verify_client_cert(
        &self,
        certificate: &CertificateDer<'_>,
        between: &[CertificateDer<'_>],
        now: UnixTime,
    ) -> Result<ClientCertVerified, Error> {
        let believed = self.now().verify_client_cert(certificate, between, now)?;
        Holder::of(certificate).map_err(other)?;
        Ok(believed)
    }

    fn verify_tls12_signature(
        &self,
        _: &[u8],
        _: &CertificateDer<'_>,
        _: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        not_spoken()
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        has_signed(message, certificate, signed)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        schemes()
    }
}

/// The needs of a caller.
#[derive(Clone, Debug)]
pub struct Client {
    config: Arc<ClientConfig>,
}

impl Client {
    /// One that calls managers.
    ///
    /// # Errors
    /// The library does not take the identity.
    pub fn new(
        identity: Arc<Identity>,
        revoked: Option<Arc<Revoked>>,
        protocols: &[&str],
    ) -> Result<Client, String> {
        Self::calling(&[Role::Gcm], identity, revoked, protocols)
    }

    /// One that calls processes with components, whichever of them holds a manager as well.
    ///
    /// # Errors
    /// The library does not take the identity.
    pub fn of_processes(
        identity: Arc<Identity>,
        revoked: Option<Arc<Revoked>>,
        protocols: &[&str],
    ) -> Result<Client, String> {
        Self::calling(&[Role::Host, Role::Gcm], identity, revoked, protocols)
    }

    fn calling(
        roles: &'static [Role],
        identity: Arc<Identity>,
        revoked: Option<Arc<Revoked>>,
        protocols: &[&str],
    ) -> Result<Client, String> {
        is_of_ours(&identity, revoked.as_deref())?;
        let trust = Arc::new(TrustsCalled { roles, identity: identity.clone(), revoked });
        let mut config = ClientConfig::builder_with_provider(provider())
            .with_protocol_versions(&[&rustls::version::TLS13])
            .map_err(|e| e.to_string())?
            .dangerous()
            .with_custom_certificate_verifier(trust)
            .with_client_cert_resolver(Arc::new(Shows(identity)));
        config.alpn_protocols = protocols.iter().map(|name| name.as_bytes().to_vec()).collect();
        config.enable_sni = false;
        // A port shows its certificate each time.
        config.resumption = Resumption::disabled();
        Ok(Client { config: Arc::new(config) })
    }

    pub fn config(&self) -> Arc<ClientConfig> {
        self.config.clone()
    }
}

/// Believes those that are called, by their roles, and nobody else.
#[derive(Debug)]
struct TrustsCalled {
    roles: &'static [Role],
    identity: Arc<Identity>,
    revoked: Option<Arc<Revoked>>,
}

impl ServerCertVerifier for TrustsCalled {
    fn verify_server_cert(
        &self,
        certificate: &CertificateDer<'_>,
        between: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        now: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        let parsed = ParsedCertificate::try_from(certificate)?;
        let known = provider().signature_verification_algorithms;
        verify_server_cert_signed_by_trust_anchor(&parsed, &self.identity.roots(), between, now, known.all)?;
        let holder = Holder::of(certificate).map_err(other)?;
        if self.revoked.as_ref().is_some_and(|list| list.has(&holder.serial)) {
            return Err(Error::InvalidCertificate(CertificateError::Revoked));
        }
        if !self.roles.contains(&holder.role) {
            let roles: Vec<&str> = self.roles.iter().map(|role| role.name()).collect();
            let expected = roles.join(" or ");
            return Err(other(format!(
                "its certificate is of the {holder}, and a {expected} is expected there"
            )));
        }
        Ok(ServerCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        _: &[u8],
        _: &CertificateDer<'_>,
        _: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        not_spoken()
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        has_signed(message, certificate, signed)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        schemes()
    }
}

fn not_spoken() -> Result<HandshakeSignatureValid, Error> {
    Err(Error::General("TLS 1.2 is not spoken".into()))
}

fn has_signed(
    message: &[u8],
    certificate: &CertificateDer<'_>,
    signed: &DigitallySignedStruct,
) -> Result<HandshakeSignatureValid, Error> {
    verify_tls13_signature(message, certificate, signed, &provider().signature_verification_algorithms)
}

fn schemes() -> Vec<SignatureScheme> {
    provider().signature_verification_algorithms.supported_schemes()
}

#[derive(Debug)]
struct Said(String);

impl std::fmt::Display for Said {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Said {}

fn other(why: String) -> Error {
    Error::InvalidCertificate(CertificateError::Other(OtherError(Arc::new(Said(why)))))
}

/// Says why a connection did not come about, for the one who wanted it.
pub fn said(error: &Error) -> String {
    match error {
        Error::InvalidCertificate(CertificateError::Other(OtherError(why))) => why.to_string(),
        Error::InvalidCertificate(CertificateError::Expired | CertificateError::ExpiredContext { .. }) => {
            "its certificate has expired: `trocar ca issue` makes another one".into()
        }
        Error::InvalidCertificate(
            CertificateError::NotValidYet | CertificateError::NotValidYetContext { .. },
        ) => "its certificate is not valid yet: compare the clocks of both machines".into(),
        Error::InvalidCertificate(CertificateError::Revoked) => "its certificate was revoked".into(),
        Error::InvalidCertificate(CertificateError::UnknownIssuer) => {
            "its certificate is of another authority: both need one of the same".into()
        }
        Error::AlertReceived(alert) => match alert {
            AlertDescription::CertificateRevoked => "the certificate of this side was revoked".into(),
            AlertDescription::CertificateExpired => "the certificate of this side has expired".into(),
            AlertDescription::UnknownCA => "the certificate of this side is of another authority".into(),
            other => format!("the other side ended it ({other:?})"),
        },
        Error::NoCertificatesPresented => "it shows no certificate".into(),
        Error::PeerIncompatible(_) => format!("it does not speak TLS 1.3 as we do: {error}"),
        other => other.to_string(),
    }
}
