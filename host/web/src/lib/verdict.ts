/// What the server says of a connection before it is made.
///
/// Invariant: it is the server's own answer to `validate_only`, never a guess of the page.
import { ConnectError } from '@connectrpc/connect';
import { gcm, said } from './api';
import { isClient, offers } from './ports.svelte';

export interface Verdict {
  /// When it was said, ms of the page.
  at: number;
  asking: boolean;
  /// Empty: it can be connected.
  refusal: string;
}

/// Client end, then server end.
export function ends(a: string, b: string): [string, string] {
  const kind = offers.port(a)?.kind;
  return kind && isClient(kind) ? [a, b] : [b, a];
}

export async function judge(client: string, server: string): Promise<Verdict> {
  let refusal = '';
  try {
    await gcm.connect({ client, server, validateOnly: true }, { timeoutMs: 3000 });
  } catch (error) {
    refusal = said(ConnectError.from(error));
  }
  return { at: performance.now(), asking: false, refusal };
}
