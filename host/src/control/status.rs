//! Refusal → gRPC status: code, one sentence, ErrorInfo{reason, domain, metadata}, field violations, help.
//!
//! Invariant: the one file that maps refusals to gRPC codes.

use std::collections::HashMap;

use tonic::{Code as Wire, Status};
use tonic_types::{ErrorDetails, StatusExt};
use trocar_model::{Code, Refusal};

/// Domain of every reason.
pub(super) const DOMAIN: &str = "trocar.v1";

/// The canonical spelling of a gRPC code.
pub(super) fn code_name(code: Wire) -> &'static str {
    match code {
        Wire::Ok => "OK",
        Wire::Cancelled => "CANCELLED",
        Wire::Unknown => "UNKNOWN",
        Wire::InvalidArgument => "INVALID_ARGUMENT",
        Wire::DeadlineExceeded => "DEADLINE_EXCEEDED",
        Wire::NotFound => "NOT_FOUND",
        Wire::AlreadyExists => "ALREADY_EXISTS",
        Wire::PermissionDenied => "PERMISSION_DENIED",
        Wire::ResourceExhausted => "RESOURCE_EXHAUSTED",
        Wire::FailedPrecondition => "FAILED_PRECONDITION",
        Wire::Aborted => "ABORTED",
        Wire::OutOfRange => "OUT_OF_RANGE",
        Wire::Unimplemented => "UNIMPLEMENTED",
        Wire::Internal => "INTERNAL",
        Wire::Unavailable => "UNAVAILABLE",
        Wire::DataLoss => "DATA_LOSS",
        Wire::Unauthenticated => "UNAUTHENTICATED",
    }
}

pub(super) fn status(refusal: &Refusal) -> Status {
    let mut details = ErrorDetails::new();
    let metadata: HashMap<String, String> = refusal.metadata().into_iter().collect();
    details.set_error_info(refusal.reason(), DOMAIN, metadata);
    for (field, description) in refusal.field_violations() {
        details.add_bad_request_violation(field, description);
    }
    details.add_help_link(refusal.help(), "");
    Status::with_error_details(code(refusal.code()), refusal.to_string(), details)
}

fn code(code: Code) -> Wire {
    match code {
        Code::InvalidArgument => Wire::InvalidArgument,
        Code::NotFound => Wire::NotFound,
        Code::AlreadyExists => Wire::AlreadyExists,
        Code::FailedPrecondition => Wire::FailedPrecondition,
        Code::Aborted => Wire::Aborted,
        Code::DeadlineExceeded => Wire::DeadlineExceeded,
        Code::Unavailable => Wire::Unavailable,
        Code::ResourceExhausted => Wire::ResourceExhausted,
        Code::PermissionDenied => Wire::PermissionDenied,
        Code::Unimplemented => Wire::Unimplemented,
        Code::Internal => Wire::Internal,
    }
}
