//! A store in memory with a fault, for tests.

use async_trait::async_trait;
use futures_util::stream::BoxStream;
use futures_util::{StreamExt, TryStreamExt, stream};
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{
    CopyOptions, Error, GetOptions, GetResult, ListResult, MultipartUpload, ObjectMeta, ObjectStore,
    ObjectStoreExt, PutMultipartOptions, PutOptions, PutPayload, PutResult,
};
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

/// The fault of a store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    None,
    /// Every request takes 2 s.
    Slow,
    /// Every request fails.
    Gone,
    /// No write is accepted.
    ReadOnly,
    /// No read is accepted, whether there is an object or not.
    WriteOnly,
    /// Every write fails, as on a full disk.
    Full,
    /// Every object has a flipped bit.
    Damaged,
    /// Every object is that of another chunk.
    Foreign,
    /// Every object is cut.
    Cut,
    /// Lists are refused, as are absent objects: S3 without the right to list.
    Unlisted,
    /// A list does not end.
    Silent,
}

/// A store in memory with a fault.
#[derive(Debug)]
pub struct Faulty {
    pub objects: Arc<InMemory>,
    pub fault: Fault,
}

impl fmt::Display for Faulty {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.fault)
    }
}

fn refused(path: &str) -> Error {
    Error::PermissionDenied { path: path.into(), source: "403".into() }
}

impl Faulty {
    async fn begin(&self) -> object_store::Result<()> {
        match self.fault {
            Fault::Slow => tokio::time::sleep(Duration::from_secs(2)).await,
            Fault::Gone => return Err(Error::Generic { store: "test", source: "gone".into() }),
            _ => {}
        }
        Ok(())
    }
}

#[async_trait]
impl ObjectStore for Faulty {
    async fn put_opts(
        &self,
        path: &Path,
        bytes: PutPayload,
        options: PutOptions,
    ) -> object_store::Result<PutResult> {
        self.begin().await?;
        if self.fault == Fault::ReadOnly {
            return Err(refused(path.as_ref()));
        }
        if self.fault == Fault::Full {
            return Err(Error::Generic { store: "test", source: "no space".into() });
        }
        self.objects.put_opts(path, bytes, options).await
    }

    async fn put_multipart_opts(
        &self,
        path: &Path,
        options: PutMultipartOptions,
    ) -> object_store::Result<Box<dyn MultipartUpload>> {
        self.objects.put_multipart_opts(path, options).await
    }

    async fn get_opts(&self, path: &Path, options: GetOptions) -> object_store::Result<GetResult> {
        self.begin().await?;
        if self.fault == Fault::WriteOnly {
            return Err(refused(path.as_ref()));
        }
        if self.fault == Fault::Foreign && path.as_ref().ends_with("base") {
            let all: Vec<ObjectMeta> = self.objects.list(None).try_collect().await?;
            let other = all.into_iter().map(|object| object.location).find(|other| other != path);
            return self.objects.get_opts(other.as_ref().unwrap_or(path), options).await;
        }
        let found = match self.objects.get_opts(path, options).await {
            Err(Error::NotFound { .. }) if self.fault == Fault::Unlisted => {
                return Err(refused(path.as_ref()));
            }
            found => found?,
        };
        if !matches!(self.fault, Fault::Damaged | Fault::Cut) {
            return Ok(found);
        }
        let (meta, mut bytes) = (found.meta.clone(), found.bytes().await?.to_vec());
        match self.fault {
            Fault::Damaged => bytes[30] ^= 1,
            _ => bytes.truncate(bytes.len() / 2),
        }
        let scratch = InMemory::new();
        scratch.put(&meta.location, bytes.into()).await?;
        scratch.get(&meta.location).await
    }

    fn delete_stream(
        &self,
        paths: BoxStream<'static, object_store::Result<Path>>,
    ) -> BoxStream<'static, object_store::Result<Path>> {
        self.objects.delete_stream(paths)
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, object_store::Result<ObjectMeta>> {
        match self.fault {
            Fault::Unlisted => stream::iter([Err(refused("list"))]).boxed(),
            Fault::Silent => stream::pending().boxed(),
            _ => self.objects.list(prefix),
        }
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> object_store::Result<ListResult> {
        self.objects.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> object_store::Result<()> {
        self.objects.copy_opts(from, to, options).await
    }
}
