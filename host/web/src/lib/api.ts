/// The port that served this page, as a client: gRPC-Web on the page's own origin.
///
/// Invariant: nothing else is ever asked, and a refusal reaches the user in the server's own words.
import { fromJson, type JsonValue } from '@bufbuild/protobuf';
import { ValueSchema, type Value } from '@bufbuild/protobuf/wkt';
import { Code, ConnectError, createClient } from '@connectrpc/connect';
import { createGrpcWebTransport } from '@connectrpc/connect-web';
import { GcmService } from '../gen/trocar/v1/gcm_pb';
import { InteractService } from '../gen/trocar/v1/interact_pb';

const transport = createGrpcWebTransport({ baseUrl: location.origin });

export const gcm = createClient(GcmService, transport);
export const interact = createClient(InteractService, transport);

/// How long a call that changes or asks something may take, ms.
export const PATIENCE = { timeoutMs: 8000 };

/// What a failed call says, without the code's name before it.
export function said(error: unknown): string {
  const e = ConnectError.from(error);
  if (e.code === Code.Unavailable || /failed to fetch|networkerror|load failed/i.test(e.rawMessage)) {
    return e.rawMessage && !/fetch|network|load failed/i.test(e.rawMessage) ? e.rawMessage : 'no answer at this address';
  }
  return e.rawMessage || Code[e.code];
}

export function wasAborted(error: unknown): boolean {
  return ConnectError.from(error).code === Code.Canceled;
}

/// True when nobody refused: the way to the server is gone.
export function isGone(error: unknown): boolean {
  const e = ConnectError.from(error);
  return e.code === Code.Unknown || e.code === Code.Unavailable || e.code === Code.Internal;
}

export type Json = null | boolean | number | string | Json[] | { [key: string]: Json };

/// The library's own conversion refuses what is not finite; plots show gaps there.
export function plain(value: Value | undefined): Json {
  const kind = value?.kind;
  switch (kind?.case) {
    case 'numberValue':
    case 'stringValue':
    case 'boolValue':
      return kind.value;
    case 'listValue':
      return kind.value.values.map(plain);
    case 'structValue': {
      const object: { [key: string]: Json } = {};
      for (const key in kind.value.fields) object[key] = plain(kind.value.fields[key]);
      return object;
    }
    default:
      return null;
  }
}

export function wrapped(json: Json): Value {
  return fromJson(ValueSchema, json as JsonValue);
}
