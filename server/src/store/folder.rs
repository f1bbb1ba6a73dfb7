//! A folder as a store. Its engine creates a missing folder with all its parents, and so would fill
//! the disk under a volume that is not mounted: here a write needs the folder.

use async_trait::async_trait;
use futures_util::stream::BoxStream;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{
    CopyOptions, Error, GetOptions, GetResult, ListResult, MultipartUpload, ObjectMeta, ObjectStore,
    PutMultipartOptions, PutOptions, PutPayload, PutResult, Result,
};
use std::fmt;
use std::path::PathBuf;
use tokio::task::spawn_blocking;

/// The objects of the whole file system, of which those below a folder are written while it exists.
#[derive(Debug)]
pub struct Folder {
    files: LocalFileSystem,
    path: PathBuf,
}

impl Folder {
    /// The store of a folder. Nothing is looked for yet.
    #[must_use]
    pub fn new(path: PathBuf) -> Self {
        Self { files: LocalFileSystem::new(), path }
    }

    /// An error unless the folder exists.
    async fn exists(&self) -> Result<()> {
        let path = self.path.clone();
        if spawn_blocking(move || path.is_dir()).await? {
            return Ok(());
        }
        let why = format!("the folder {} does not exist any more; mount its volume", self.path.display());
        Err(Error::Generic { store: "folder", source: why.into() })
    }
}

impl fmt::Display for Folder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.files.fmt(f)
    }
}

#[async_trait]
impl ObjectStore for Folder {
    async fn put_opts(&self, path: &Path, bytes: PutPayload, options: PutOptions) -> Result<PutResult> {
        self.exists().await?;
        self.files.put_opts(path, bytes, options).await
    }

    async fn put_multipart_opts(
        &self,
        path: &Path,
        options: PutMultipartOptions,
    ) -> Result<Box<dyn MultipartUpload>> {
        self.exists().await?;
        self.files.put_multipart_opts(path, options).await
    }

    async fn get_opts(&self, path: &Path, options: GetOptions) -> Result<GetResult> {
        self.files.get_opts(path, options).await
    }

    fn delete_stream(&self, paths: BoxStream<'static, Result<Path>>) -> BoxStream<'static, Result<Path>> {
        self.files.delete_stream(paths)
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        self.files.list(prefix)
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.files.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
        self.exists().await?;
        self.files.copy_opts(from, to, options).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::StoreAddress;
    use object_store::ObjectStoreExt;

    /// The control is the same write while the folder exists.
    #[tokio::test]
    async fn a_folder_that_disappears_is_not_created_again() {
        let folder = std::env::temp_dir().join(format!("tombolo-folder-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (objects, root) = StoreAddress::parse(folder.to_str().unwrap()).unwrap().open().unwrap();
        let path = root.join("world").join("object");
        objects.put(&path, "1".into()).await.unwrap();
        assert_eq!(objects.get(&path).await.unwrap().bytes().await.unwrap(), "1");
        std::fs::remove_dir_all(&folder).unwrap();
        let error = objects.put(&path, "2".into()).await.unwrap_err().to_string();
        assert!(error.contains(folder.to_str().unwrap()) && !folder.exists(), "{error}");
        assert!(matches!(objects.get(&path).await, Err(Error::NotFound { .. })));
    }
}
