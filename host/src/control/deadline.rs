//! Duration of a call: the caller's `grpc-timeout`, never more than the server's cap.

use std::time::{Duration, Instant};

use tonic::Request;

/// Limit when the caller names none.
const DEFAULT: Duration = Duration::from_secs(5);
/// Upper limit, whatever the caller says.
pub(super) const CAP: Duration = Duration::from_secs(60);

/// The moment by which this call must have its answer.
pub(super) fn deadline<T>(request: &Request<T>) -> Instant {
    callers(request).unwrap_or_else(|| Instant::now() + DEFAULT)
}

/// The caller's own deadline, if it names one.
pub(super) fn callers<T>(request: &Request<T>) -> Option<Instant> {
    let asked = request.metadata().get("grpc-timeout").and_then(|v| v.to_str().ok()).and_then(parse);
    asked.map(|asked| Instant::now() + asked.min(CAP))
}

/// Returns the part of the caller's time to keep back, so that the answer arrives before the caller gives up.
pub(super) fn room(until: Instant) -> Duration {
    let left = until.saturating_duration_since(Instant::now());
    (left / 5).clamp(Duration::from_millis(60), Duration::from_millis(500)).min(left)
}

/// The gRPC spelling: up to eight digits and a unit.
fn parse(text: &str) -> Option<Duration> {
    let (digits, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
    let n: u64 = digits.parse().ok().filter(|_| digits.len() <= 8)?;
    Some(match unit {
        "H" => Duration::from_secs(n * 3600),
        "M" => Duration::from_secs(n * 60),
        "S" => Duration::from_secs(n),
        "m" => Duration::from_millis(n),
        "u" => Duration::from_micros(n),
        "n" => Duration::from_nanos(n),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_callers_timeout_is_kept_below_the_cap() {
        assert_eq!(parse("250m"), Some(Duration::from_millis(250)));
        assert_eq!(parse("99999999S"), Some(Duration::from_secs(99_999_999)));
        assert_eq!(parse("123456789S"), None);
        assert_eq!(parse("ü"), None);
        let mut request = Request::new(());
        request.set_timeout(Duration::from_secs(3600));
        assert!(deadline(&request) <= Instant::now() + CAP);
    }
}
