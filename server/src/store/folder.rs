//! A folder as a store. Its engine creates a missing folder with all its parents, and so would fill
//! the disk under a volume that is not mounted: here a write needs the folder.
//!
//! Calls of the system block a thread each, and do not end while the server of a volume is gone.
//! Their number is bounded, those included whose caller has timed out.

use async_trait::async_trait;
use futures_util::stream::BoxStream;
use futures_util::{StreamExt, TryStreamExt, stream};
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{
    CopyOptions, Error, GetOptions, GetResult, GetResultPayload, ListResult, MultipartUpload, ObjectMeta,
    ObjectStore, PutMultipartOptions, PutOptions, PutPayload, PutResult, Result,
};
use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;
use tokio::sync::Semaphore;
use tokio::task::spawn_blocking;

/// Calls that have not ended: more than a server or a bake has requests in flight. One more waits
/// without a thread until its caller times out. A server counts that as a failure; after five in a
/// row it stops reads, or writes, but for one in 5 s, until the folder answers. Writes that hang
/// must not take the permits of reads that do not.
const READS: usize = 80;
const WRITES: usize = 16;

/// The objects of the whole file system, of which those below a folder are written while it exists.
#[derive(Clone, Debug)]
pub struct Folder {
    files: LocalFileSystem,
    path: PathBuf,
    /// One permit per call that has not ended.
    reads: Arc<Semaphore>,
    writes: Arc<Semaphore>,
}

impl Folder {
    /// The store of a folder. Nothing is looked for yet.
    #[must_use]
    pub fn new(path: PathBuf) -> Self {
        let [reads, writes] = [READS, WRITES].map(|calls| Arc::new(Semaphore::new(calls)));
        Self { files: LocalFileSystem::new(), path, reads, writes }
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

/// Runs a call in a task of its own, which keeps its permit until the call ends, also if the caller
/// has timed out.
async fn run<T: Send + 'static>(
    permits: &Arc<Semaphore>,
    call: impl Future<Output = Result<T>> + Send + 'static,
) -> Result<T> {
    // Never none: the semaphore is not closed.
    let permit = Arc::clone(permits).acquire_owned().await.ok();
    let running = tokio::spawn(async move {
        let result = call.await;
        drop(permit);
        result
    });
    running.await?
}

impl fmt::Display for Folder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.files.fmt(f)
    }
}

#[async_trait]
impl ObjectStore for Folder {
    async fn put_opts(&self, path: &Path, bytes: PutPayload, options: PutOptions) -> Result<PutResult> {
        let (folder, path) = (self.clone(), path.clone());
        run(&self.writes, async move {
            folder.exists().await?;
            folder.files.put_opts(&path, bytes, options).await
        })
        .await
    }

    async fn put_multipart_opts(
        &self,
        path: &Path,
        options: PutMultipartOptions,
    ) -> Result<Box<dyn MultipartUpload>> {
        let (folder, path) = (self.clone(), path.clone());
        run(&self.writes, async move {
            folder.exists().await?;
            folder.files.put_multipart_opts(&path, options).await
        })
        .await
    }

    async fn get_opts(&self, path: &Path, options: GetOptions) -> Result<GetResult> {
        let (folder, path) = (self.clone(), path.clone());
        let found = run(&self.reads, async move { folder.files.get_opts(&path, options).await }).await?;
        let (meta, range) = (found.meta.clone(), found.range.clone());
        let (attributes, extensions) = (found.attributes.clone(), found.extensions.clone());
        // The file is read by a second call, if at all.
        let reads = Arc::clone(&self.reads);
        let bytes = stream::once(async move { run(&reads, found.bytes()).await });
        let payload = GetResultPayload::Stream(bytes.boxed());
        Ok(GetResult { payload, meta, range, attributes, extensions })
    }

    fn delete_stream(&self, paths: BoxStream<'static, Result<Path>>) -> BoxStream<'static, Result<Path>> {
        self.files.delete_stream(paths)
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        let start = (self.clone(), self.files.list(prefix));
        stream::try_unfold(start, |(folder, mut objects)| async move {
            let next = run(&folder.reads, async move {
                let next = objects.try_next().await;
                next.map(|next| (next, objects))
            });
            let (next, objects) = next.await?;
            Ok(next.map(|object| (object, (folder, objects))))
        })
        .boxed()
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        let (folder, prefix) = (self.clone(), prefix.cloned());
        run(&self.reads, async move { folder.files.list_with_delimiter(prefix.as_ref()).await }).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
        let (folder, from, to) = (self.clone(), from.clone(), to.clone());
        run(&self.writes, async move {
            folder.exists().await?;
            folder.files.copy_opts(&from, &to, options).await
        })
        .await
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

    #[tokio::test]
    async fn objects_of_a_folder_are_listed_and_read_in_parts() {
        let folder = std::env::temp_dir().join(format!("tombolo-listed-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (objects, root) = StoreAddress::parse(folder.to_str().unwrap()).unwrap().open().unwrap();
        let names = ["a", "b", "c"].map(|name| root.clone().join(name));
        for name in &names {
            objects.put(name, "0123".into()).await.unwrap();
        }
        let listed: Vec<ObjectMeta> = objects.list(Some(&root)).try_collect().await.unwrap();
        let mut listed: Vec<Path> = listed.into_iter().map(|object| object.location).collect();
        listed.sort();
        assert_eq!(listed, names);
        assert_eq!(objects.get_range(&names[0], 1..3).await.unwrap(), "12");
        assert_eq!(objects.head(&names[0]).await.unwrap().size, 4);
        std::fs::remove_dir_all(&folder).unwrap();
    }

    /// The open of a pipe without a writer does not end, like that of a file on a volume whose
    /// server is gone. The control is the same read after a writer has ended the open.
    #[cfg(unix)]
    #[tokio::test(flavor = "multi_thread")]
    async fn a_read_that_hangs_keeps_its_permit_after_its_timeout() {
        use std::time::Duration;
        use tokio::time::timeout;

        let path = std::env::temp_dir().join(format!("tombolo-hung-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        let (file, pipe) = (path.join("file"), path.join("pipe"));
        std::fs::write(&file, "1").unwrap();
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let folder = Folder { reads: Arc::new(Semaphore::new(1)), ..Folder::new(path.clone()) };
        let [whole, hung] = [&file, &pipe].map(|path| Path::from_absolute_path(path).unwrap());
        let has_timed_out = timeout(Duration::from_millis(50), folder.get(&hung)).await.is_err();
        let left = folder.reads.available_permits();
        // Before all checks: a runtime waits for its blocked threads.
        let writer = spawn_blocking(move || std::fs::File::options().write(true).open(pipe));
        let writer = writer.await.unwrap().unwrap();
        assert_eq!((has_timed_out, left), (true, 0));
        assert_eq!(folder.get(&whole).await.unwrap().bytes().await.unwrap(), "1");
        drop(writer);
        std::fs::remove_dir_all(&path).unwrap();
    }
}
