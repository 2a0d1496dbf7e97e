//! The server: connections, headers of safety, the stream of states.
//!
//! One thread serves all connections, and never waits for the engine or for a client. Bounds: the
//! number of connections, the size of headers, the time that a client may take to send a request or
//! to take an answer, the size of the bodies that `POST` brings, and how many of them there are at
//! once.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use bytes::Bytes;
use http_body_util::{BodyExt, Either, Full, Limited};
use hyper::body::{Body, Frame, Incoming};
use hyper::header::{self, HeaderName, HeaderValue};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use serde_json::json;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, mpsc};
use tokio_io_timeout::TimeoutStream;

use crate::answer::{Answer, Failure};
use crate::gate::{Gate, Verdict};
use crate::query::Query;
use crate::routes;
use crate::server_context::ServerContext;

/// Connections at once; more wait to be accepted.
const MAX_CONNECTIONS: usize = 128;
/// Bytes of a request's headers; a camera is in its address.
const MAX_HEADER_BYTES: usize = 32 << 10;
/// Bytes of a request's body.
const MAX_BODY_BYTES: usize = 32 << 20;
/// Time that a client may take to send a request, and that it may be idle.
const REQUEST_TIME: Duration = Duration::from_secs(60);
/// Time that a client may take nothing of an answer.
const STALLED_TIME: Duration = Duration::from_secs(10);
/// Time between signs of life in the stream of states.
const ALIVE_EVERY: Duration = Duration::from_secs(10);
/// The least time between states in the stream.
const STATE_EVERY: Duration = Duration::from_millis(200);

/// The page may load its own files and nothing else, be shown in no other page, and send no forms.
const CONTENT_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; \
                              connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'";

type Content = Either<Full<Bytes>, StateStream>;

/// Accepts connections for ever.
pub(crate) async fn serve(listener: TcpListener, gate: Arc<Gate>, context: Arc<ServerContext>) {
    let places = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    loop {
        let Ok(place) = Arc::clone(&places).acquire_owned().await else { return };
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            // Out of files, or a client that left at once.
            Err(_) => {
                tokio::time::sleep(Duration::from_millis(50)).await;
                continue;
            }
        };
        let (gate, context) = (Arc::clone(&gate), Arc::clone(&context));
        tokio::spawn(async move {
            converse(stream, gate, context).await;
            drop(place);
        });
    }
}

async fn converse(stream: TcpStream, gate: Arc<Gate>, context: Arc<ServerContext>) {
    // Small answers are not to wait for larger ones.
    let _ = stream.set_nodelay(true);
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(STALLED_TIME));
    let service = service_fn(move |request| {
        let (gate, context) = (Arc::clone(&gate), Arc::clone(&context));
        async move { Ok::<_, Infallible>(respond(request, &gate, &context).await) }
    });
    let mut connection = http1::Builder::new();
    connection.timer(TokioTimer::new()).header_read_timeout(REQUEST_TIME).max_buf_size(MAX_HEADER_BYTES);
    // A client that breaks the protocol, stalls or leaves ends its own connection alone.
    let _ = connection.serve_connection(TokioIo::new(Box::pin(stream)), service).await;
}

async fn respond(request: Request<Incoming>, gate: &Gate, context: &Arc<ServerContext>) -> Response<Content> {
    let uri = request.uri().clone();
    let query = Query::parse(uri.query().unwrap_or_default());
    let token = uri.query().and_then(|query| query.split('&').find_map(|pair| pair.strip_prefix("token=")));
    let verdict = gate.judge(request.headers(), token);
    let answered = match (verdict, query) {
        (Verdict::Refused(why), _) => Err(Failure::new(StatusCode::FORBIDDEN, why)),
        (_, Err(message)) => Err(Failure::from(message)),
        (_, Ok(_)) if uri.path() == "/api/events" && *request.method() == Method::GET => return events(context),
        (_, Ok(query)) => {
            let method = request.method().clone();
            match body_of(request, context).await {
                Ok(body) => routes::answer(context, &method, uri.path(), query, body).await,
                Err(failure) => Err(failure),
            }
        }
    };
    let mut response = match answered {
        Ok(answer) => success(answer),
        Err(failure) => refusal(&failure),
    };
    if let (Verdict::WelcomeWithToken, Some(cookie)) = (verdict, gate.cookie())
        && let Ok(cookie) = HeaderValue::from_str(&cookie)
    {
        response.headers_mut().insert(header::SET_COOKIE, cookie);
    }
    response
}

/// Receives the body of a `POST`; other requests have none.
async fn body_of(request: Request<Incoming>, context: &ServerContext) -> Result<Bytes, Failure> {
    let size = request.body().size_hint();
    if size.upper() == Some(0) {
        return Ok(Bytes::new());
    }
    let too_large = |message: String| Failure::new(StatusCode::PAYLOAD_TOO_LARGE, message);
    if *request.method() != Method::POST {
        return Err(too_large("only POST may have a body".into()));
    }
    if size.lower() > MAX_BODY_BYTES as u64 {
        return Err(too_large(format!("a body of {} bytes, expected at most {MAX_BODY_BYTES}", size.lower())));
    }
    let Ok(_place) = context.bodies.try_acquire() else {
        return Err(Failure::new(StatusCode::SERVICE_UNAVAILABLE, "too many bodies at once, try again"));
    };
    match tokio::time::timeout(REQUEST_TIME, Limited::new(request.into_body(), MAX_BODY_BYTES).collect()).await {
        Ok(Ok(body)) => Ok(body.to_bytes()),
        Ok(Err(error)) => Err(too_large(format!("the body did not arrive: {error}"))),
        Err(_) => Err(Failure::new(StatusCode::REQUEST_TIMEOUT, "the body did not arrive in time")),
    }
}

fn success(answer: Answer) -> Response<Content> {
    let mut response = Response::new(Either::Left(Full::new(answer.body)));
    *response.status_mut() = answer.status;
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(answer.media_type));
    if let Some(Ok(head)) = answer.frame_head.map(|head| HeaderValue::from_str(&head)) {
        headers.insert(HeaderName::from_static("luxel-frame"), head);
    }
    if let Some(Ok(value)) = answer.file_name.map(|name| HeaderValue::from_str(&format!("attachment; filename=\"{name}\""))) {
        headers.insert(header::CONTENT_DISPOSITION, value);
    }
    with_safety(response)
}

fn refusal(failure: &Failure) -> Response<Content> {
    let body = json!({ "error": failure.message }).to_string();
    let mut response = Response::new(Either::Left(Full::new(Bytes::from(body))));
    *response.status_mut() = failure.status;
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("application/json"));
    with_safety(response)
}

fn with_safety(mut response: Response<Content>) -> Response<Content> {
    let headers = response.headers_mut();
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, CONTENT_POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-store"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

/// Answers with a stream of states, one event each.
fn events(context: &Arc<ServerContext>) -> Response<Content> {
    // One state waits at most; the next is the newest.
    let (sender, receiver) = mpsc::channel(1);
    let mut states = context.shared.listen();
    tokio::spawn(async move {
        loop {
            let text = match tokio::time::timeout(ALIVE_EVERY, states.changed()).await {
                Ok(Ok(())) => {
                    let status = states.borrow_and_update().clone();
                    format!("data: {}\n\n", serde_json::to_string(&status).unwrap_or_default())
                }
                // The training is over, and with it the viewer.
                Ok(Err(_)) => return,
                Err(_) => ":\n\n".into(),
            };
            if sender.send(Bytes::from(text)).await.is_err() {
                return;
            }
            tokio::time::sleep(STATE_EVERY).await;
        }
    });
    let mut response = Response::new(Either::Right(StateStream(receiver)));
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("text/event-stream"));
    with_safety(response)
}

/// The body of the stream of states.
pub(crate) struct StateStream(mpsc::Receiver<Bytes>);

impl Body for StateStream {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        self.0.poll_recv(context).map(|text| text.map(|text| Ok(Frame::data(text))))
    }
}

/// Binds the address.
pub(crate) fn bind(address: SocketAddr) -> std::io::Result<std::net::TcpListener> {
    let listener = std::net::TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}
