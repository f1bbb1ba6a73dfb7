//! The address of a store: its URL and the settings of its engine in the environment.

use super::folder::Folder;
use object_store::path::Path;
use object_store::{ObjectStore, parse_url_opts};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::Duration;
use url::Url;

/// Environment variables with these prefixes are settings of an engine, such as `AWS_REGION`,
/// `AWS_ENDPOINT`, `GOOGLE_SERVICE_ACCOUNT`, `AZURE_STORAGE_ACCOUNT_NAME`.
const SETTINGS: [&str; 3] = ["AWS_", "GOOGLE_", "AZURE_"];

/// Schemes of URLs that are accepted: those that the options name. `object_store` knows more, among
/// them `memory`, whose objects end with the process.
const SCHEMES: [&str; 4] = ["file", "s3", "gs", "az"];

/// Time in which a folder has to answer at the start.
const FOLDER_TIMEOUT: Duration = Duration::from_secs(10);

/// A checked address. It may not hold secrets: those stand in the environment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoreAddress(Url);

impl StoreAddress {
    /// Parses a URL, or the path of a folder.
    ///
    /// # Errors
    /// The fault and the valid forms.
    pub fn parse(text: &str) -> Result<Self, String> {
        let help = "give file:///FOLDER, s3://BUCKET/PREFIX, gs://BUCKET/PREFIX or az://CONTAINER/PREFIX";
        let shown = shown(text);
        if has_one_slash(text) {
            return Err(format!("`{shown}` has one slash after the colon; {help}"));
        }
        if !text.contains("://") {
            let folder = std::path::absolute(text).map_err(|_| format!("`{shown}` is no folder; {help}"))?;
            let url = Url::from_directory_path(&folder);
            return url.map(Self).map_err(|()| format!("`{shown}` is no folder; {help}"));
        }
        let url = Url::parse(text).map_err(|error| format!("`{shown}` is no URL ({error}); {help}"))?;
        if !SCHEMES.contains(&url.scheme()) {
            return Err(format!("`{}` is not known; {help}", url.scheme()));
        }
        if url.scheme() != "file" && cfg!(not(feature = "object-stores")) {
            return Err(format!(
                "this server was built without {}; build it with the feature `object-stores`, or give \
                 file:///FOLDER",
                url.scheme()
            ));
        }
        if !url.username().is_empty() || url.password().is_some() || url.query().is_some() {
            return Err(
                "credentials belong into the environment, such as AWS_ACCESS_KEY_ID, not into the URL".into(),
            );
        }
        Ok(Self(url))
    }

    /// The store and the path of its root. Nothing is sent yet.
    ///
    /// A folder has to exist, and is not created again where it disappears later.
    ///
    /// # Errors
    /// The settings of the engine are invalid, or the folder does not exist.
    pub fn open(&self) -> Result<(Arc<dyn ObjectStore>, Path), String> {
        let folder = self.folder();
        if let Some(path) = folder.clone() {
            let shown = path.display().to_string().escape_debug().to_string();
            match within(FOLDER_TIMEOUT, move || path.is_dir()) {
                Some(true) => {}
                Some(false) => {
                    return Err(format!(
                        "the folder {shown} does not exist; create it, or mount the volume that it lies on"
                    ));
                }
                None => {
                    return Err(format!(
                        "the folder {shown} does not answer within {} s; check the volume that it lies on",
                        FOLDER_TIMEOUT.as_secs()
                    ));
                }
            }
        }
        // The first caller decides; all choose the same.
        let _ = rustls::crypto::ring::default_provider().install_default();
        // Variables that are no text are none of the settings.
        let settings = std::env::vars_os()
            .filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)))
            .filter(|(name, _)| SETTINGS.iter().any(|prefix| name.starts_with(prefix)))
            .map(|(name, value)| (name.to_ascii_lowercase(), value));
        let (store, root) = parse_url_opts(&self.0, settings)
            .map_err(|error| format!("{error}; look at the settings of its engine in the environment"))?;
        let store = folder.map_or_else(|| store.into(), |folder| Arc::new(Folder::new(folder)) as _);
        Ok((store, root))
    }

    /// The folder, if it is one.
    fn folder(&self) -> Option<PathBuf> {
        // Only a URL of a file with a host is none; the engine rejects it.
        (self.0.scheme() == "file").then(|| self.0.to_file_path().ok()).flatten()
    }
}

/// The result of a call that may never end, as of a file on a volume whose server is gone; none if
/// it takes longer than a limit. Its thread then remains until the process ends.
fn within<T: Send + 'static>(limit: Duration, call: impl FnOnce() -> T + Send + 'static) -> Option<T> {
    let (sender, result) = sync_channel(1);
    std::thread::spawn(move || _ = sender.try_send(call()));
    result.recv_timeout(limit).ok()
}

/// Whether a text is a URL with one slash too few, such as `s3:/bucket`: it would be the path of a
/// folder. A letter alone is a drive of Windows.
fn has_one_slash(text: &str) -> bool {
    text.split_once(":/").is_some_and(|(scheme, rest)| {
        let is_scheme = scheme.len() > 1 && scheme.chars().all(|letter| letter.is_ascii_alphanumeric());
        is_scheme && !rest.starts_with('/')
    })
}

/// An invalid address as errors show it: in one line, without what may be a secret. The text before
/// the last `@` may be a name and a password, also with characters that they should not hold; a
/// query may be a signature.
fn shown(text: &str) -> String {
    let (scheme, rest) = text.find("://").map_or(("", text), |colon| text.split_at(colon + 3));
    let (user, rest) = rest.rsplit_once('@').map_or(("", rest), |(_, rest)| ("***@", rest));
    let (rest, query) = rest.split_once('?').map_or((rest, ""), |(rest, _)| (rest, "?***"));
    // A line break of the text must not break the line of the error.
    format!("{scheme}{user}{rest}{query}").escape_debug().to_string()
}

impl std::fmt::Display for StoreAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_and_urls_of_engines_are_addresses() {
        assert_eq!(StoreAddress::parse("/data/chunks").unwrap().to_string(), "file:///data/chunks/");
        for url in ["s3://bucket/some/prefix", "gs://bucket", "az://container/x"] {
            assert_eq!(StoreAddress::parse(url).unwrap().to_string(), url);
        }
    }

    #[test]
    fn a_folder_that_does_not_exist_is_an_error_and_stays_absent() {
        let folder = std::env::temp_dir().join(format!("tombolo-address-{}/below it", std::process::id()));
        let address = StoreAddress::parse(folder.to_str().unwrap()).unwrap();
        let error = address.open().unwrap_err();
        assert!(error.contains(folder.to_str().unwrap()) && error.contains("create it"), "{error}");
        assert!(!folder.exists());
        std::fs::create_dir_all(&folder).unwrap();
        let (_, root) = address.open().unwrap();
        std::fs::remove_dir_all(folder.parent().unwrap()).unwrap();
        assert_eq!(format!("/{root}"), folder.to_str().unwrap());
    }

    #[test]
    fn a_call_that_never_ends_has_no_result() {
        let (_open, never) = sync_channel::<()>(0);
        assert_eq!(within(Duration::from_millis(10), move || never.recv().ok()), None);
        assert_eq!(within(FOLDER_TIMEOUT, || 7), Some(7));
    }

    #[test]
    fn schemes_that_the_options_do_not_name_are_errors() {
        for scheme in ["memory", "s3a", "azure", "abfss", "http"] {
            let error = StoreAddress::parse(&format!("{scheme}://x/y")).unwrap_err();
            assert!(error.starts_with(&format!("`{scheme}` is not known; give file:///FOLDER, s3://")));
        }
    }

    #[test]
    fn other_schemes_and_secrets_are_errors_that_say_what_to_give() {
        for (text, word) in [
            ("ftp://host/x", "s3://"),
            ("memory:///x", "`memory` is not known; give file:///FOLDER, s3://BUCKET/PREFIX"),
            ("s3://", "s3://"),
            ("s3:/bucket/x", "`s3:/bucket/x` has one slash after the colon; give file:///FOLDER"),
            ("file:/data/chunks", "one slash"),
            ("gs:/", "one slash"),
            ("s3:/key:secret@bucket", "one slash"),
            ("s3://key:secret@bucket/x", "AWS_ACCESS_KEY_ID"),
            ("az://container/x?sig=secret", "environment"),
            ("gs://\0ck\n", "gs://"),
            // No URLs: none of them is shown whole.
            ("s3://key:secret@bu cket/x", "`s3://***@bu cket/x`"),
            ("s3://key:se/secret+@bucket:port", "`s3://***@bucket:port`"),
            ("s3://key:secret@:x@bucket:port", "`s3://***@bucket:port`"),
            ("az://bad host/x?sig=secret", "`az://bad host/x?***`"),
            ("az://bad host/x?sig=secret@y", "`az://***@y`"),
            ("s3://key:sec?secret@bucket", "`s3://***@bucket`"),
        ] {
            match StoreAddress::parse(text) {
                Err(error) => {
                    assert!(error.contains(word), "{text}: {error}");
                    assert!(!error.contains("secret") && error.lines().count() == 1, "{error}");
                }
                Ok(address) => assert!(address.open().is_err(), "{text}"),
            }
        }
    }
}
