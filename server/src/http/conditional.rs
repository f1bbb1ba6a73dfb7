//! Representations with a strong validator, and conditional requests: RFC 9110, sections 8.8.3
//! and 13.

use crate::http::problem::{Problem, ProblemKind};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use headers::{ETag, HeaderMapExt, IfMatch, IfNoneMatch};

/// A representation of a resource, with its cache metadata.
#[derive(Clone, Debug)]
pub struct Representation {
    /// The strong validator, quotes included.
    pub etag: HeaderValue,
    /// Media type.
    pub content_type: &'static str,
    /// Value of `Cache-Control`.
    pub cache_control: &'static str,
    /// The content.
    pub body: Bytes,
}

/// A strong validator from a digest of the content.
#[must_use]
pub fn etag(digest: &[u8]) -> HeaderValue {
    let hex: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
    // Hexadecimal digits and quotes are valid in a header.
    HeaderValue::from_str(&format!("\"{hex}\"")).unwrap_or(HeaderValue::from_static("\"\""))
}

/// `Cache-Control` of an immutable resource. A resource that requires a token is private: shared
/// caches would serve it without the token (RFC 9111, section 3.5).
#[must_use]
pub const fn immutable_cache_control(requires_token: bool) -> &'static str {
    if requires_token {
        "private, max-age=31536000, immutable"
    } else {
        "public, max-age=31536000, immutable"
    }
}

impl Representation {
    /// The response to a GET or HEAD request. `If-Match` takes precedence over `If-None-Match`
    /// (RFC 9110, section 13.2.2); ranges are not supported.
    #[must_use]
    pub fn respond(self, request: &HeaderMap) -> Response {
        let etag = self.etag.to_str().ok().and_then(|text| text.parse::<ETag>().ok());
        // A list that cannot be read names no tag of ours.
        let matches = |list: Option<IfMatch>| {
            etag.as_ref().zip(list).is_some_and(|(etag, list)| list.precondition_passes(etag))
        };
        if request.contains_key(header::IF_MATCH) && !matches(request.typed_get()) {
            let shown = self.etag.to_str().unwrap_or_default();
            return Problem::new(
                ProblemKind::PreconditionFailed,
                format!("`If-Match` does not contain {shown}"),
            )
            .into_response();
        }
        let validators = [
            (header::ETAG, self.etag.clone()),
            (header::CACHE_CONTROL, HeaderValue::from_static(self.cache_control)),
        ];
        let is_known = |list: IfNoneMatch| etag.as_ref().is_some_and(|etag| !list.precondition_passes(etag));
        if request.typed_get().is_some_and(is_known) {
            return (StatusCode::NOT_MODIFIED, validators).into_response();
        }
        (validators, [(header::CONTENT_TYPE, self.content_type)], self.body).into_response()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderName;

    fn status(name: &HeaderName, lines: &[&'static str]) -> StatusCode {
        let mut request = HeaderMap::new();
        for line in lines {
            request.append(name.clone(), HeaderValue::from_static(line));
        }
        let representation = Representation {
            etag: HeaderValue::from_static("\"abc\""),
            content_type: "text/plain",
            cache_control: "no-cache",
            body: Bytes::from_static(b"body"),
        };
        representation.respond(&request).status()
    }

    #[test]
    fn if_none_match_compares_weakly_in_lists_and_over_lines() {
        for lines in [
            &["\"abc\""][..],
            &["W/\"abc\""],
            &["*"],
            &["\"x\", \"abc\""],
            &["\"x\",,\t\"abc\" ,"],
            &["\"x\"", "W/\"abc\""],
            &["\"a,b\",\"abc\""],
        ] {
            assert_eq!(status(&header::IF_NONE_MATCH, lines), StatusCode::NOT_MODIFIED, "{lines:?}");
        }
        for lines in [
            &["\"abd\""][..],
            &["abc"],
            &["W/W/\"abc\""],
            &["w/\"abc\""],
            &["\"x,\"abc\""],
            &["\"\""],
            &["\"abc"],
            &[""],
            &[",,"],
            &["\"*\""],
        ] {
            assert_eq!(status(&header::IF_NONE_MATCH, lines), StatusCode::OK, "{lines:?}");
        }
    }

    #[test]
    fn if_match_compares_strongly_and_fails_with_412() {
        for lines in [&["\"abc\""][..], &["*"], &["W/\"abc\", \"abc\""]] {
            assert_eq!(status(&header::IF_MATCH, lines), StatusCode::OK, "{lines:?}");
        }
        for lines in [&["W/\"abc\""][..], &["\"abd\""], &["abc"], &[""]] {
            assert_eq!(status(&header::IF_MATCH, lines), StatusCode::PRECONDITION_FAILED, "{lines:?}");
        }
    }

    #[test]
    fn an_etag_is_the_hexadecimal_digest_in_quotes() {
        assert_eq!(etag(&[0, 0xab, 15]), "\"00ab0f\"");
    }
}
