/// What a menu is opened on.
export interface Target {
  kind: 'component' | 'connection' | 'process' | 'pane' | 'remove';
  path: string;
  /// The port under the pointer, process/component/port.
  port?: string;
}
