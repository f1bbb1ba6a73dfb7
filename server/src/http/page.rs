//! The page at `/` and its files, embedded in the binary. A content security policy forbids other
//! sources.

use crate::http::conditional::{Representation, etag};
use crate::http::problem::{Problem, ProblemKind};
use axum::extract::Path;
use axum::extract::rejection::PathRejection;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::Response;
use bytes::Bytes;

/// Content Security Policy Level 3: the page loads from this server only.
const POLICY: &str = "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// One file of the page.
struct File {
    name: &'static str,
    content_type: &'static str,
    body: &'static str,
}

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

/// The page is the first file.
const FILES: [File; 8] = [
    File { name: "index.html", content_type: HTML, body: include_str!("../../page/index.html") },
    File {
        name: "style.css",
        content_type: "text/css; charset=utf-8",
        body: include_str!("../../page/style.css"),
    },
    File { name: "icon.svg", content_type: "image/svg+xml", body: include_str!("../../page/icon.svg") },
    File { name: "main.js", content_type: SCRIPT, body: include_str!("../../page/main.js") },
    File { name: "view.js", content_type: SCRIPT, body: include_str!("../../page/view.js") },
    File { name: "tiles.js", content_type: SCRIPT, body: include_str!("../../page/tiles.js") },
    File { name: "clients.js", content_type: SCRIPT, body: include_str!("../../page/clients.js") },
    File { name: "panel.js", content_type: SCRIPT, body: include_str!("../../page/panel.js") },
];

/// `GET /`.
pub async fn index(headers: HeaderMap) -> Response {
    FILES[0].respond(&headers)
}

/// `GET /page/{name}`.
pub async fn file(
    headers: HeaderMap,
    name: Result<Path<String>, PathRejection>,
) -> Result<Response, Problem> {
    let file = name.ok().and_then(|Path(name)| FILES.iter().find(|file| file.name == name));
    let Some(file) = file else {
        return Err(Problem::new(ProblemKind::NoRoute, "the page has no such file; it begins at /"));
    };
    Ok(file.respond(&headers))
}

impl File {
    fn respond(&self, request: &HeaderMap) -> Response {
        let representation = Representation {
            // A few kilobytes once per visit: hashing is cheaper than a cache.
            etag: etag(&blake3::hash(self.body.as_bytes()).as_bytes()[..16]),
            content_type: self.content_type,
            // Always revalidated, so that a new server never mixes with files of an old page.
            cache_control: "no-cache",
            body: Bytes::from_static(self.body.as_bytes()),
        };
        let mut response = representation.respond(request);
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY));
        headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
        response
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_references_existing_local_files_only() {
        let mut named = 0;
        for file in &FILES {
            for part in file.body.split(['"', '\'', '`', '(', ')', ' ', '\n']) {
                // XML namespaces are not loaded.
                let is_foreign = part.contains("//")
                    && part
                        .split_once("//")
                        .is_some_and(|(scheme, _)| scheme.ends_with("http:") || scheme.ends_with("https:"));
                assert!(!is_foreign || part == "http://www.w3.org/2000/svg", "{}: {part}", file.name);
                let local = part.strip_prefix("/page/").or(part.strip_prefix("./"));
                if let Some(name) = local.filter(|name| name.contains('.')) {
                    named += 1;
                    assert!(FILES.iter().any(|file| file.name == name), "{}: {part}", file.name);
                }
            }
        }
        assert!(named >= FILES.len() - 1, "every file but the first is referenced: {named}");
    }

    #[test]
    fn the_page_complies_with_its_policy() {
        let page = FILES[0].body;
        for word in [" style=", "<style", " onclick=", " onload=", "javascript:"] {
            assert!(!page.contains(word), "{word}");
        }
        assert_eq!(page.matches("<script").count(), page.matches("<script type=\"module\" src=").count());
    }
}
