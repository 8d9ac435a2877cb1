//! The macro that makes [`Refusal`](crate::Refusal) of its rows.
//!
//! Invariant: all that is said of a refusal is in its row, and a row that lacks a part does not compile.

macro_rules! refusals {
    (; $(
        $(#[$doc:meta])*
        $kind:ident { $($(#[$field_doc:meta])* $field:ident: $ty:ty),* $(,)? } => {
            code: $code:ident,
            reason: $reason:literal,
            sentence: $sentence:expr,
            help: $help:expr,
            metadata: $metadata:expr,
            $(violations: $violations:expr,)?
            example: $example:expr,
        }
    )*) => {
        #[derive(Clone, Debug, PartialEq)]
        pub enum Refusal {
            $($(#[$doc])* $kind { $($(#[$field_doc])* $field: $ty),* },)*
        }

        #[allow(unused_variables, reason = "a part of a row takes those fields that it needs")]
        impl Refusal {
            pub fn code(&self) -> Code {
                match self { $(Refusal::$kind { .. } => Code::$code,)* }
            }

            /// `reason` of the ErrorInfo; its domain is "trocar.v1".
            pub fn reason(&self) -> &'static str {
                match self { $(Refusal::$kind { .. } => $reason,)* }
            }

            /// The help, as one or two whole sentences.
            pub fn help(&self) -> String {
                match self { $(Refusal::$kind { $($field),* } => String::from($help),)* }
            }

            /// The values of the refusal by name: ids, `nearest`, `known`; lists are separated by commas.
            pub fn metadata(&self) -> BTreeMap<String, String> {
                match self { $(Refusal::$kind { $($field),* } => $metadata.0,)* }
            }

            /// Returns (field of the request, what is wrong with it), for the BadRequest detail; empty where
            /// no field is to blame.
            pub fn field_violations(&self) -> Vec<(String, String)> {
                match self {
                    $(Refusal::$kind { $($field),* } => {
                        iter::empty()$(.chain($violations))?.take(metadata::MOST).collect()
                    })*
                }
            }

            /// One of each, in the order in which the checks are made.
            pub fn examples() -> Vec<Refusal> {
                use self::examples::*;
                use Refusal::*;
                vec![$($example),*]
            }

            /// The name of the variant.
            pub fn kind(&self) -> &'static str {
                match self { $(Refusal::$kind { .. } => stringify!($kind),)* }
            }

            /// The fields by name, of which [`Refusal::from_values`] makes the refusal again.
            pub fn values(&self) -> Vec<(&'static str, Value)> {
                match self {
                    $(Refusal::$kind { $($field),* } => vec![$((stringify!($field), $field.put())),*],)*
                }
            }

            /// The refusal of this kind with these values; nothing when the kind or a value is unknown.
            pub fn from_values(kind: &str, value: impl Fn(&str) -> Option<Value>) -> Option<Refusal> {
                match kind {
                    $(stringify!($kind) => Some(Refusal::$kind {
                        $($field: Travels::take(&value(stringify!($field))?)?),*
                    }),)*
                    _ => None,
                }
            }
        }

        #[allow(unused_variables, reason = "a sentence takes those fields that it needs")]
        impl fmt::Display for Refusal {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                match self { $(Refusal::$kind { $($field),* } => f.write_str(&$sentence),)* }
            }
        }
    };
}
